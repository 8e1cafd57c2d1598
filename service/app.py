"""The application: what it holds, from start to end, and which routes there are."""

from __future__ import annotations

import asyncio
import logging
import os
import re
import threading
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager, suppress
from functools import partial
from importlib.metadata import version
from typing import Any

import redis
from anyio import to_thread
from fastapi import Depends, FastAPI
from fastapi.security import HTTPBearer
from starlette.middleware.cors import CORSMiddleware
from starlette.types import Scope

from backend import once
from backend.queue import JobQueue
from backend.redis_connection import connect
from backend.tracing import open_tracing
from schemas.errors import SilhouetteError
from service import damage, errors
from service.access.guard import AccessGuard
from service.access.policy import open_access
from service.assets import AssetCache
from service.body_limit import BodyLimit
from service.forms import is_form
from service.head import HeadAsGet
from service.meshes import Meshes
from service.observing.collector import ServiceCollector
from service.observing.metrics import Metrics
from service.observing.middleware import Observed, RouteNoted
from service.picture_cache import PictureCache
from service.readiness import Readiness
from service.render.context import EglUnavailableError
from service.render.renderer import Renderer
from service.request_record import REQUEST_ID
from service.routes import access, accuracy, artifacts, docs, frames, health, meshes, metrics, moved, page, render, scenes, silhouette
from service.routes import once as one_request
from service.routes.documented import problems
from service.security_headers import SecurityHeaders
from service.settings import ServiceSettings
from service.slots import Slots
from service.state import Services
from service.warm import warm_in_background

log = logging.getLogger("silhouette.service")

ROUTES = (page, docs, meshes, moved, render, frames, scenes, silhouette, one_request, accuracy, artifacts, access, metrics, health)
"""In the order in which they are tried: forms at addresses that take JSON too come first."""

MESH_BODIES = frozenset({"/v1/meshes", "/v1/render", "/v1/silhouette"})
"""Addresses that take a mesh, and count its bytes themselves."""
MOVED_BODIES = re.compile(r"/v1/meshes/[^/]+/(render|silhouette|frames)")
"""Those that take positions in a form, and count them likewise."""

KEYED: dict[str, Any] = {
    "dependencies": [Depends(HTTPBearer(auto_error=False, description="an API key, where the service asks for one"))],
    "responses": problems(400, 401, 403, 429),
}
"""What OpenAPI says of all calls but health; that it is so is the guard's work."""

SHARED_WITH_PAGES: dict[str, Any] = {
    "allow_methods": ["GET", "HEAD", "POST", "DELETE"],
    "allow_headers": ["Authorization", "X-API-Key", "Content-Type", "If-None-Match", "Range", REQUEST_ID],
    "expose_headers": [
        *("ETag", "Location", "Retry-After", "Server-Timing", "X-Plan", "X-Accuracy", "X-Image-Size", "X-Frames", "X-Hull", REQUEST_ID),
        *("RateLimit-Limit", "RateLimit-Remaining", "RateLimit-Reset"),
    ],
    "max_age": 3600,
}
"""What pages of the origins in `cors_origins` may send and read. No cookies are there to be let through."""

DESCRIPTION = """Upload a heavy mesh once; from then on get any view in milliseconds, without a GPU, with an outline that is exactly
the original's although only a coarse hull is drawn, or the silhouette itself as JSON or SVG."""

CLOSE_S = 2.0
"""Seconds that work under way may hold up the end of the process."""

CHECK_S = 2.0
"""Longest that a check of readiness may take: a disk that hangs is no better than none."""

PROBE_S = 0.5
"""Longest that somebody who asks how the queue is waits for its answer, twice."""

CPU_DEPTH = 64
"""CPU work of a kind that may wait; most takes milliseconds."""


def create_app(settings: ServiceSettings) -> FastAPI:
    """The application. It opens store, queue and renderer when it starts, and needs `settings.redis_url` then."""
    counted, tracing = Metrics(), open_tracing("service", settings.trace_endpoint)

    @asynccontextmanager
    async def lifespan(app: FastAPI) -> AsyncIterator[None]:
        services = await to_thread.run_sync(_open, settings)
        app.state.services = services
        counted.registry.register(collector := ServiceCollector(services))
        if settings.warm_renderer and services.renderer_fault is None:
            warm_in_background(services.renderer)
        keeper = asyncio.create_task(_tend(services), name="tend")
        try:
            yield
        finally:
            keeper.cancel()
            with suppress(asyncio.CancelledError):
                await keeper
            await services.access.requests.close()
            counted.registry.unregister(collector)
            _close(services)
            if tracing is not None:
                await to_thread.run_sync(tracing.close)

    app = FastAPI(
        title="Silhouette Service",
        description=DESCRIPTION,
        version=version("silhouette-service"),
        lifespan=lifespan,
        docs_url=None,
        redoc_url=None,
    )
    app.state.metrics = counted
    errors.install(app)
    damage.install(app)
    app.add_middleware(RouteNoted)
    app.add_middleware(BodyLimit, limit_bytes=settings.max_body_kib * 1024, unlimited=counts_itself)
    app.add_middleware(AccessGuard, allowed_origins=settings.cors_origins)
    app.add_middleware(HeadAsGet)
    if settings.cors_origins:
        app.add_middleware(CORSMiddleware, allow_origins=settings.cors_origins, **SHARED_WITH_PAGES)
    app.add_middleware(SecurityHeaders, is_shared=bool(settings.cors_origins), has_tls=settings.behind_tls)
    app.add_middleware(Observed, metrics=counted, tracing=tracing, writes_lines=settings.log_requests)
    for module in ROUTES:
        app.include_router(module.router, **({} if module is health else KEYED))
    return app


def counts_itself(scope: Scope) -> bool:
    """Whether what answers a request bounds its body."""
    path = scope["path"]
    return path in MESH_BODIES or (is_form(scope) and MOVED_BODIES.fullmatch(path) is not None)


def _open(settings: ServiceSettings) -> Services:
    queue = JobQueue.open(settings)
    assert settings.redis_url is not None
    limit_s = settings.render_timeout_s
    renderer, fault = Renderer(settings.render_depth, settings.gpu_cache_mib, true_times=True, limit_s=limit_s), None
    try:
        renderer.start()
    except EglUnavailableError as error:  # uploads, silhouettes and downloads work without; /readyz says what is missing
        fault = str(error)
        log.critical("the renderer did not start: %s", error)
    return Services(
        settings=settings,
        store=queue.store,
        once=once.store_of(queue.store),
        queue=queue,
        probe=connect(settings.redis_url, settings.redis_password_file, settings.redis_ca_file, timeout_s=PROBE_S),
        meshes=Meshes(queue.store, queue.progress, measure=settings.measure),
        assets=AssetCache(queue.store, settings.asset_cache_mib),
        renderer=renderer,
        pictures=PictureCache(settings.picture_cache_mib * 2**20),
        cpu=Slots(max(2, os.cpu_count() or 1), CPU_DEPTH, "cpu"),
        documents=Slots(max(2, os.cpu_count() or 1), CPU_DEPTH, "documents"),
        access=open_access(settings, queue.store),
        readiness=Readiness(CHECK_S),
        renderer_fault=fault,
    )


def _close(services: Services) -> None:
    """Close what is open. A frame or kernel under way is waited for, but not for long: its thread ends with the process."""
    closing = [threading.Thread(target=part.close, daemon=True) for part in (services.renderer, services.cpu, services.documents)]
    for thread in closing:
        thread.start()
    for thread in closing:
        thread.join(CLOSE_S)
    services.queue.redis.close()
    services.probe.close()


async def _tend(services: Services) -> None:
    """Sweep this machine's temporary files, then in its turns bring to the queue what is not finished and go through the whole store."""
    settings, queue = services.settings, services.queue
    for store in (services.store, services.once):
        try:
            await to_thread.run_sync(store.sweep_temporary, settings.temporary_age_s)
        except (SilhouetteError, OSError) as error:
            log.warning("temporary files are not swept: %s", error)
    reconcile = partial(queue.reconcile_in_turn, settings.reconcile_interval_s)
    audit = partial(queue.audit_in_turn, settings.audit_interval_s, settings.temporary_age_s)
    async with asyncio.TaskGroup() as group:  # beside each other: a look at the whole store may take long
        for call in (reconcile, audit):
            group.create_task(_repeat(call, settings.reconcile_interval_s))


async def _repeat(call: Callable[[], None], pause_s: float) -> None:
    """Do this now and again so long after its end, whatever has been lost meanwhile. Cancelled, it does not wait for what is being done."""
    while True:
        try:
            await to_thread.run_sync(call, abandon_on_cancel=True)
        except (redis.RedisError, SilhouetteError, OSError) as error:
            log.warning("the store is not compared with the queue: %s", error)
        await asyncio.sleep(pause_s)
