"""Calls that cost something, made no more often than they have to be."""

from __future__ import annotations

import time
from collections.abc import Callable


class Paced:
    """A function that is called when this is, but at most once in `interval_s` seconds; 0: every time."""

    def __init__(self, function: Callable[[], None], interval_s: float) -> None:
        self._function = function
        self._interval_s = interval_s
        self._next_s = 0.0

    def __call__(self) -> None:
        """Call the function if its time has come. Raises what it raises."""
        now_s = time.monotonic()
        if now_s >= self._next_s:
            self._next_s = now_s + self._interval_s
            self._function()
