"""Pure ASGI middleware: what a browser may do with an answer, where the answer does not say so itself."""

from __future__ import annotations

from starlette.datastructures import MutableHeaders
from starlette.types import ASGIApp, Message, Receive, Scope, Send

DOCUMENT_POLICY = "default-src 'none'; style-src 'unsafe-inline'; sandbox; frame-ancestors 'none'"
"""For what is no page of ours: a drawing that somebody opens may be styled, and runs nothing."""

HSTS = "max-age=31536000"


class SecurityHeaders:
    """Adds the headers that are missing. is_shared: other origins may take answers; has_tls: the service is reached by TLS alone."""

    def __init__(self, app: ASGIApp, *, is_shared: bool, has_tls: bool) -> None:
        self.app = app
        self.headers = {
            "X-Content-Type-Options": "nosniff",
            "Referrer-Policy": "no-referrer",  # an address may have a signature
            "Content-Security-Policy": DOCUMENT_POLICY,
            "Cross-Origin-Resource-Policy": "cross-origin" if is_shared else "same-origin",
            **({"Strict-Transport-Security": HSTS} if has_tls else {}),
        }

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass the request on."""
        if scope["type"] != "http":
            await self.app(scope, receive, send)
            return

        async def send_with_headers(message: Message) -> None:
            if message["type"] == "http.response.start":
                answer = MutableHeaders(scope=message)
                for name, value in self.headers.items():
                    answer.setdefault(name, value)
            await send(message)

        await self.app(scope, receive, send_with_headers)
