"""Pure ASGI middleware: small requests stay small. Uploads count for themselves, everything else is bounded here."""

from __future__ import annotations

from collections.abc import Callable

from starlette.datastructures import Headers
from starlette.exceptions import HTTPException
from starlette.types import ASGIApp, Message, Receive, Scope, Send


class BodyLimit:
    """Refuses with 413 a body over `limit_bytes` of every request that is not `unlimited`, by its scope."""

    def __init__(self, app: ASGIApp, limit_bytes: int, unlimited: Callable[[Scope], bool]) -> None:
        self.app = app
        self.limit_bytes = limit_bytes
        self.unlimited = unlimited

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass the request on with its body counted."""
        if scope["type"] != "http" or self.unlimited(scope):
            await self.app(scope, receive, send)
            return
        declared = Headers(scope=scope).get("content-length", "0")
        too_long = not declared.isdecimal() or int(declared) > self.limit_bytes
        seen = 0

        async def bounded() -> Message:
            nonlocal seen
            if too_long:
                raise HTTPException(status_code=413)
            message = await receive()
            seen += len(message.get("body", b""))
            if seen > self.limit_bytes:
                raise HTTPException(status_code=413)
            return message

        await self.app(scope, bounded, send)
