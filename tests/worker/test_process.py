"""Children that a worker does something in, beside its work."""

import os
import signal
import time
from pathlib import Path

from tests.worker.forks import lives
from worker.process import Asides


def ended(asides, seconds=20.0):
    deadline = time.monotonic() + seconds
    while asides.busy() and time.monotonic() < deadline:
        time.sleep(0.01)
    return not asides.busy()


def test_an_aside_runs_in_a_process_of_its_own_and_is_reaped(tmp_path):
    asides = Asides()
    asides.start(lambda: (tmp_path / "pid").write_text(str(os.getpid())))
    assert ended(asides)
    pid = int((tmp_path / "pid").read_text())
    assert pid != os.getpid() and not Path(f"/proc/{pid}").exists()


def test_an_aside_is_busy_until_it_ends_and_its_failure_is_its_own():
    asides = Asides()
    asides.start(lambda: time.sleep(0.5))
    asides.start(lambda: 1 // 0)
    assert asides.busy()
    assert ended(asides)


def test_an_aside_dies_with_its_parent(tmp_path):
    child = os.fork()
    if child == 0:
        Asides().start(lambda: ((tmp_path / "pid").write_text(str(os.getpid())), time.sleep(60.0)))
        time.sleep(60.0)
        os._exit(0)
    deadline = time.monotonic() + 20.0
    while not (tmp_path / "pid").exists() and time.monotonic() < deadline:
        time.sleep(0.01)
    time.sleep(0.1)
    aside = int((tmp_path / "pid").read_text())
    os.kill(child, signal.SIGKILL)
    os.waitpid(child, 0)
    while lives(aside) and time.monotonic() < deadline:
        time.sleep(0.01)
    assert not lives(aside)
