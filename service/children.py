"""Child processes that are kept running, and that cannot outlive this process."""

from __future__ import annotations

import logging
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

log = logging.getLogger("silhouette.children")

LAUNCHER = Path(__file__).with_name("launcher.py")
POLL_S = 0.1
FIRST_BACKOFF_S, LAST_BACKOFF_S = 0.1, 5.0
STEADY_S = 10.0  # a child that lived so long starts again at the first backoff


@dataclass(frozen=True)
class Child:
    """A program to keep running.

    death_signal: what it gets when this process dies. output: file for its output, begun anew at each start; none: ours.
    on_exit: called with the exit status (negative: signal) before it is started again. files: numbers of open ones that it gets.
    """

    name: str
    command: tuple[str, ...]
    environment: Mapping[str, str] = field(default_factory=dict)
    death_signal: signal.Signals = signal.SIGKILL
    output: Path | None = None
    on_exit: Callable[[int], None] | None = None
    files: tuple[int, ...] = ()


class _Slot:
    """One child: its process, and when it may be started again."""

    def __init__(self, child: Child) -> None:
        self.child = child
        self.process: subprocess.Popen[bytes] | None = None
        self.started_s = 0.0
        self.start_at_s = 0.0
        self.backoff_s = FIRST_BACKOFF_S


class Supervisor:
    """Starts children, starts them again when they end, and stops them.

    Its thread starts them all, since the death signal is bound to the life of the starting thread; it runs until `stop`, or
    until this process ends.
    """

    def __init__(self) -> None:
        self._slots: list[_Slot] = []
        self._lock = threading.Lock()
        self._wake = threading.Event()
        self._stopping = False
        self._thread = threading.Thread(target=self._run, name="supervisor", daemon=True)

    def start(self) -> None:
        """Start the supervising thread."""
        self._thread.start()

    def add(self, child: Child) -> None:
        """Keep `child` running from now on."""
        with self._lock:
            self._slots.append(_Slot(child))
        self._wake.set()

    def pids(self) -> dict[str, int]:
        """Name -> process id of the children that run."""
        with self._lock:
            return {s.child.name: s.process.pid for s in self._slots if s.process is not None and s.process.poll() is None}

    def remove(self, names: list[str], grace_s: float) -> None:
        """Stop the named children together: SIGTERM, and SIGKILL for those that are still there after `grace_s`."""
        with self._lock:
            leaving = [slot for slot in self._slots if slot.child.name in names]
            self._slots = [slot for slot in self._slots if slot.child.name not in names]
            processes = [slot.process for slot in leaving if slot.process is not None]
        for process in processes:
            process.terminate()
        deadline = time.monotonic() + grace_s
        for process in processes:
            try:
                process.wait(max(0.0, deadline - time.monotonic()))
            except subprocess.TimeoutExpired:
                log.warning("killed a child that did not stop", extra={"pid": process.pid})
                process.kill()
                process.wait()

    def stop(self, grace_s: float) -> None:
        """Stop all children and the thread."""
        self.remove([slot.child.name for slot in self._slots], grace_s)
        self._stopping = True
        self._wake.set()
        if self._thread.is_alive():
            self._thread.join()

    def _run(self) -> None:
        while not self._stopping:
            self._wake.clear()
            with self._lock:
                for slot in self._slots:
                    self._tend(slot)
            self._wake.wait(POLL_S)

    def _tend(self, slot: _Slot) -> None:
        if slot.process is not None:
            status = slot.process.poll()
            if status is None:
                return
            self._ended(slot, status)
        if slot.process is None and time.monotonic() >= slot.start_at_s:
            try:
                slot.process = _spawn(slot.child)
            except OSError:  # no processes or memory left: try again later
                log.exception("child not started", extra={"child": slot.child.name})
                slot.start_at_s = time.monotonic() + LAST_BACKOFF_S
                return
            slot.started_s = time.monotonic()

    def _ended(self, slot: _Slot, status: int) -> None:
        lived_s = time.monotonic() - slot.started_s
        slot.backoff_s = FIRST_BACKOFF_S if lived_s > STEADY_S else min(2 * slot.backoff_s, LAST_BACKOFF_S)
        slot.process, slot.start_at_s = None, time.monotonic() + slot.backoff_s
        log.warning("child ended", extra={"child": slot.child.name, "status": status, "lived_s": round(lived_s, 2)})
        if slot.child.on_exit is not None:
            try:
                slot.child.on_exit(status)
            except OSError:  # the others are kept running, whatever it was
                log.exception("what the end of a child calls for was not done", extra={"child": slot.child.name})


def _spawn(child: Child) -> subprocess.Popen[bytes]:
    command = [sys.executable, "-I", "-S", str(LAUNCHER), str(os.getpid()), str(int(child.death_signal)), *child.command]
    environment = {**os.environ, **child.environment}
    if child.output is None:
        return subprocess.Popen(command, env=environment, stdin=subprocess.DEVNULL, start_new_session=True, pass_fds=child.files)
    with child.output.open("wb") as output:
        return subprocess.Popen(
            command,
            env=environment,
            stdin=subprocess.DEVNULL,
            stdout=output,
            stderr=subprocess.STDOUT,
            start_new_session=True,
            pass_fds=child.files,
        )
