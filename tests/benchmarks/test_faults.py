import subprocess
import sys
import time

import pytest

from benchmarks.faults import Outcome, processes_of, run


@pytest.mark.heavy
def test_uploads_survive_killed_workers_and_a_killed_server():
    outcome = run(uploads=4, kills=2, server_kills=1, seed=3, detail=3)
    assert outcome.is_good, outcome
    assert outcome.worker_kills + outcome.fork_kills == 2 and outcome.server_kills == 1


@pytest.mark.parametrize("fault", [{"right": 1}, {"twice": 1}, {"orphans": 1}, {"temporary_files": 1}])
def test_anything_lost_doubled_or_left_is_not_good(fault):
    assert Outcome(uploads=2, right=2).is_good
    assert not Outcome(uploads=2, **{"right": 2, **fault}).is_good


def test_a_process_that_was_left_is_counted(tmp_path):
    assert processes_of(tmp_path) == 0
    left = subprocess.Popen([sys.executable, "-c", "input()", str(tmp_path)], stdin=subprocess.PIPE)
    try:
        deadline = time.monotonic() + 10.0
        while processes_of(tmp_path) != 1:  # until the new process has become the program
            assert time.monotonic() < deadline
    finally:
        left.communicate()
