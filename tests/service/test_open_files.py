"""The service takes the open files that it may have."""

import json
import subprocess
import sys

LIMITS = {(256, 4096): "4096 4096", (1000, 1000): "1000 1000"}
"""(soft, hard) that the system gives -> what the service has then."""

TOLD = """
import json, os, resource, sys
from service.__main__ import allow_files
for limits in json.loads(sys.argv[1]):
    if os.fork() == 0:
        resource.setrlimit(resource.RLIMIT_NOFILE, limits)
        allow_files()
        print(*resource.getrlimit(resource.RLIMIT_NOFILE), flush=True)
        os._exit(0)
    os.wait()
"""


def test_the_limit_is_raised_to_what_the_system_lets():
    command = [sys.executable, "-c", TOLD, json.dumps(list(LIMITS))]
    done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=120)
    assert done.stdout.splitlines() == list(LIMITS.values())
