"""Workers beside a service give way to it, whatever the kernel shares the processors between."""

import os
import subprocess
import sys
import time
from pathlib import Path

import pytest

from service.embedded import READER, WORKER_NICE, EmbeddedBackend
from worker.priority import AUTOGROUP

needs_autogroup = pytest.mark.skipif(not AUTOGROUP.exists(), reason="this kernel has no autogroup")


def session_nice(pid):
    return int(Path(f"/proc/{pid}/autogroup").read_text().split()[-1])


def told_in_a_session_of_its_own(source):
    """What a process prints that leads a new session: one that was never given one has no share of its own."""
    return subprocess.run([sys.executable, "-c", source], capture_output=True, text=True, check=True, start_new_session=True).stdout


def settled(read, wanted):
    deadline = time.monotonic() + 60.0
    while read() != wanted and time.monotonic() < deadline:
        time.sleep(0.05)
    return read() == wanted


def test_workers_beside_the_private_queue_give_way_and_the_reader_does_not(tmp_path, monkeypatch):
    monkeypatch.delenv("SILHOUETTE_NICE")
    backend = EmbeddedBackend(tmp_path / "data", 1, {"SILHOUETTE_WARM_KERNELS": "0"})
    backend.start()
    try:
        assert settled(lambda: {"worker-1", READER} <= set(backend.pids()), True)
        pids = backend.pids()
        assert settled(lambda: os.getpriority(os.PRIO_PROCESS, pids["worker-1"]), WORKER_NICE)
        if AUTOGROUP.exists():
            assert settled(lambda: session_nice(pids["worker-1"]), WORKER_NICE)
            assert session_nice(pids[READER]) == 0
        assert os.getpriority(os.PRIO_PROCESS, pids[READER]) == 0
    finally:
        backend.stop()


@needs_autogroup
def test_a_session_that_is_not_the_worker_s_own_keeps_its_share():
    told = "import os; from worker.priority import AUTOGROUP, give_way; give_way(7, os.getppid()); print(os.nice(0), AUTOGROUP.read_text())"
    assert told_in_a_session_of_its_own(told).split()[::3] == ["7", "0"]


def test_a_process_never_takes_back_what_it_gave():
    told = "import os; from worker.priority import give_way; give_way(9, os.getpid()); give_way(3, os.getpid()); print(os.nice(0))"
    assert told_in_a_session_of_its_own(told).strip() == "9"
