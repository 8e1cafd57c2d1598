"""The service takes the open files that it may have."""

import subprocess
import sys

import pytest

TOLD = """
import resource
resource.setrlimit(resource.RLIMIT_NOFILE, ({soft}, {hard}))
from service.__main__ import allow_files
allow_files()
print(*resource.getrlimit(resource.RLIMIT_NOFILE))
"""


@pytest.mark.parametrize(("soft", "hard", "found"), [(256, 4096, "4096 4096"), (1000, 1000, "1000 1000")])
def test_the_limit_is_raised_to_what_the_system_lets(soft, hard, found):
    told = TOLD.format(soft=soft, hard=hard)
    done = subprocess.run([sys.executable, "-c", told], capture_output=True, text=True, check=True, timeout=120)
    assert done.stdout.strip() == found
