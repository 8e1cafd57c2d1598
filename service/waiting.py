"""Wait for work, but not for a client that has left, nor for ever."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable
from concurrent.futures import Future
from typing import Any, TypeVar

from anyio import to_thread
from fastapi import Request
from starlette.requests import ClientDisconnect

from schemas.errors import TOO_LATE, BusyError

T = TypeVar("T")

LOOK_S = 0.01
"""Between the first two looks of `wait_until`."""
SLOWING = 1.25
ROOM_S = 0.25
"""Between two tries of `admitted`, at most."""


async def wait_for(request: Request, future: Future[T], timeout_s: float) -> T:
    """The result of `future`, which is cancelled when the client leaves or the time is up.

    Handlers are not cancelled when a client leaves, so its going is raced against the work. The body of the request must
    have been read. Raises ClientDisconnect, BusyError, and what the work raises.
    """
    work = asyncio.wrap_future(future)
    if not work.done():
        gone = asyncio.ensure_future(_gone(request))
        try:
            racers: set[asyncio.Future[Any]] = {work, gone}
            await asyncio.wait(racers, timeout=timeout_s, return_when=asyncio.FIRST_COMPLETED)
            left = gone.done()
        finally:
            gone.cancel()
        if not work.done():
            work.cancel()
            raise ClientDisconnect if left else BusyError(TOO_LATE)
    return await work


async def admitted(submit: Callable[[], Future[T]], timeout_s: float) -> Future[T]:
    """What `submit` queues, which is tried again as long as there is no room: for a part of work that was admitted already.

    Raises BusyError when there is none in time.
    """
    deadline = time.monotonic() + timeout_s
    while True:
        try:
            return submit()
        except BusyError as busy:
            if time.monotonic() + busy.retry_after_s > deadline:
                raise
            await asyncio.sleep(min(busy.retry_after_s, ROOM_S))


async def wait_until(request: Request, look: Callable[[], T | None], timeout_s: float, last_look_s: float = LOOK_S) -> T:
    """What `look` finds, once it finds something; it is asked again and again in a thread, in the end every `last_look_s` seconds.

    The body of the request must have been read. Raises ClientDisconnect, BusyError.
    """
    gone = asyncio.ensure_future(_gone(request))
    try:
        deadline = time.monotonic() + timeout_s
        look_s = LOOK_S
        while (found := await to_thread.run_sync(look)) is None:
            if gone.done():
                raise ClientDisconnect
            if time.monotonic() > deadline:
                raise BusyError(TOO_LATE)
            await asyncio.sleep(look_s)
            look_s = min(look_s * SLOWING, max(LOOK_S, last_look_s))
        return found
    finally:
        gone.cancel()


async def _gone(request: Request) -> None:
    while (await request.receive())["type"] != "http.disconnect":
        pass


class Stopwatch:
    """Milliseconds since it was made."""

    def __init__(self) -> None:
        self._start = time.perf_counter()

    def ms(self) -> float:
        """Milliseconds so far."""
        return (time.perf_counter() - self._start) * 1e3
