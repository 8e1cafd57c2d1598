"""Reading the rest of a body that was refused, so that a client that only reads after writing gets to see why."""

from __future__ import annotations

import asyncio
from contextlib import suppress

from starlette.types import Receive

DRAIN_BYTES, DRAIN_S = 64 << 20, 2.0
"""How much of it is read at most."""


async def drain(receive: Receive) -> None:
    """Read and drop what still comes of a request's body."""
    seen = 0
    with suppress(TimeoutError):
        async with asyncio.timeout(DRAIN_S):
            while seen < DRAIN_BYTES:
                message = await receive()
                seen += len(message.get("body", b""))
                if not message.get("more_body", False):
                    return
