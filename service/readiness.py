"""Looks at what the service depends on, each within a time limit and one at a time, so that what hangs takes up one thread."""

from __future__ import annotations

import asyncio
from collections.abc import Callable

from anyio import to_thread

NO_ANSWER = "does not answer in time"


class Readiness:
    """For one event loop."""

    def __init__(self, limit_s: float) -> None:
        self._limit_s = limit_s
        self._looking: dict[str, asyncio.Task[str]] = {}

    async def ask(self, name: str, look: Callable[[], str]) -> str:
        """What `look` says, which may block; `NO_ANSWER` when it takes too long. Who asks while it looks gets the same answer."""
        task = self._looking.get(name)
        if task is None or task.done():
            task = self._looking[name] = asyncio.create_task(to_thread.run_sync(look, abandon_on_cancel=True))
        try:
            return await asyncio.wait_for(asyncio.shield(task), self._limit_s)
        except TimeoutError:
            return NO_ANSWER
