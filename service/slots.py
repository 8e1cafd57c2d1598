"""Bounded admission for work off the event loop: a few threads, a short queue, an early no."""

from __future__ import annotations

import threading
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from contextvars import copy_context
from typing import Any, TypeVar

from schemas.errors import BusyError

T = TypeVar("T")


class Slots:
    """`threads` run at once, `depth` more wait; what comes on top is refused at once."""

    def __init__(self, threads: int, depth: int, name: str) -> None:
        self._pool = ThreadPoolExecutor(threads, thread_name_prefix=name)
        self._free = threading.BoundedSemaphore(threads + depth)

    def submit(self, work: Callable[..., T], *args: Any) -> Future[T]:
        """Run `work(*args)` in a slot, with the caller's context variables. Raises BusyError when all are taken."""
        if not self._free.acquire(blocking=False):
            raise BusyError("The service is doing all it can; try again in a moment.")
        future = self._pool.submit(copy_context().run, work, *args)
        future.add_done_callback(lambda _: self._free.release())
        return future

    def close(self) -> None:
        """Drop what waits and return when the running work has ended."""
        self._pool.shutdown(wait=True, cancel_futures=True)
