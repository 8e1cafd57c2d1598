"""What this process has counted, for Prometheus."""

from __future__ import annotations

from anyio import to_thread
from fastapi import APIRouter, Request, Response

from service.caching import NOT_KEPT
from service.observing.metrics import Metrics

router = APIRouter(tags=["service"])

TEXT = "text/plain; version=0.0.4; charset=utf-8"


@router.get("/metrics", response_class=Response, responses={200: {"content": {"text/plain": {}}, "description": "text format 0.0.4"}})
async def metrics(request: Request) -> Response:
    """Requests, passes, caches, queues and stages in Prometheus' text format; of requests and pictures those of this process alone."""
    counted: Metrics = request.app.state.metrics
    return Response(await to_thread.run_sync(counted.page), media_type=TEXT, headers={"Cache-Control": NOT_KEPT})
