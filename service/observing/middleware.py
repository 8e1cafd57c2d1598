"""Pure ASGI middleware around all others: gives each request its id, times it, counts it, traces it and writes its log line."""

from __future__ import annotations

import logging
import time
from contextlib import nullcontext
from typing import Any

from starlette.datastructures import Headers, MutableHeaders
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from backend.tracing import Tracing, add_passes
from service.observing.metrics import Metrics, passes_of
from service.request_record import REQUEST_ID, RequestRecord, begin_request, current_request

log = logging.getLogger("silhouette.requests")

UNANSWERED = 500
"""Status of a request whose handling broke before it had an answer; what the client gets then is made further out."""


class Observed:
    """Outermost of the middleware. writes_lines: whether each request has a line in the log."""

    def __init__(self, app: ASGIApp, *, metrics: Metrics, tracing: Tracing | None, writes_lines: bool) -> None:
        self.app = app
        self.metrics = metrics
        self.tracing = tracing
        self.writes_lines = writes_lines

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass the request on."""
        if scope["type"] != "http":
            await self.app(scope, receive, send)
            return
        headers = Headers(scope=scope)
        record = begin_request(headers.get(REQUEST_ID))
        traced = nullcontext() if self.tracing is None else self.tracing.root(scope["method"], headers, request=record.id)
        with traced as span:
            await self._timed(record, span, scope, receive, send)

    async def _timed(self, record: RequestRecord, span: Any, scope: Scope, receive: Receive, send: Send) -> None:
        start, status = time.perf_counter(), UNANSWERED
        passes: list[tuple[str, float]] = []

        async def send_marked(message: Message) -> None:
            nonlocal status, passes
            if message["type"] == "http.response.start":
                status = message["status"]
                answer = MutableHeaders(scope=message)
                answer[REQUEST_ID] = record.id
                passes = passes_of(answer.get("server-timing", ""))
            await send(message)

        try:
            await self.app(scope, receive, send_marked)
        finally:
            seconds = time.perf_counter() - start
            self.metrics.count_request(record, scope["method"], status, seconds)
            self.metrics.count_passes(passes)
            if span is not None:
                span.update_name(f"{scope['method']} {record.route}")
                span.set_attributes(
                    {"http.request.method": scope["method"], "http.route": record.route, "http.response.status_code": status}
                )
                add_passes(span, passes)
            if self.writes_lines:
                _write_line(record, scope["method"], status, seconds)


class RouteNoted:
    """Innermost of the middleware: notes which route a request came to."""

    def __init__(self, app: ASGIApp) -> None:
        self.app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass the request on."""
        try:
            await self.app(scope, receive, send)
        finally:
            record, route = current_request(), scope.get("route")
            if record is not None and route is not None:
                record.route = route.path
                record.mesh = scope.get("path_params", {}).get("mesh_id")


def _write_line(record: RequestRecord, method: str, status: int, seconds: float) -> None:
    told: dict[str, Any] = {"method": method, "route": record.route, "status": status, "ms": round(seconds * 1e3, 3)}
    told |= {name: value for name, value in (("mesh", record.mesh), ("key", record.key), ("code", record.code)) if value is not None}
    log.info("%s %s %d", method, record.route, status, extra=told)
