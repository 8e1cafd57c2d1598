"""Wait for work, but not for a client that has left, nor for ever."""

from __future__ import annotations

import asyncio
import time
from concurrent.futures import Future
from typing import Any, TypeVar

from fastapi import Request
from starlette.requests import ClientDisconnect

from schemas.errors import BusyError

T = TypeVar("T")


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
            raise ClientDisconnect if left else BusyError("The service could not answer in time; try again in a moment.")
    return await work


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
