"""Drawing that is no longer wanted ends between two passes."""

from __future__ import annotations

import threading
import time


class StoppedError(Exception):
    """Nobody waits for the picture any more, or its time is up."""


class Stop:
    """Says whether to go on. deadline_s: of `time.monotonic`."""

    def __init__(self, deadline_s: float = float("inf")) -> None:
        self._deadline_s = deadline_s
        self._asked = threading.Event()

    def ask(self) -> None:
        """Stop as soon as may be; from any thread."""
        self._asked.set()

    def check(self) -> None:
        """Raise StoppedError when it is time to."""
        if self._asked.is_set():
            raise StoppedError("nobody waits for this picture")
        if time.monotonic() > self._deadline_s:
            raise StoppedError("the time for this picture is up")


NEVER = Stop()
