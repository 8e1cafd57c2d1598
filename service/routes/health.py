"""Is the process alive, and can it do its work."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from functools import partial
from typing import Any

import redis
from fastapi import APIRouter, Response

from schemas.errors import SilhouetteError, StoreUnavailableError
from service.state import Parts, Services

router = APIRouter(tags=["health"])

OK = "ok"


@router.get("/healthz")
async def healthz() -> dict[str, str]:
    """200 while the process answers at all; looks at nothing else."""
    return {"status": "ok"}


@router.get("/readyz", responses={503: {"description": "Something it needs is missing; `checks` says what"}})
async def readyz(parts: Parts, response: Response) -> dict[str, Any]:
    """200 when a request would succeed: the queue answers, the store can be written, the renderer draws."""
    answers = await asyncio.gather(*(parts.readiness.ask(name, partial(look, parts)) for name, look in CHECKS.items()))
    checks = dict(zip(CHECKS, answers, strict=True))
    ready = all(answer == OK for answer in checks.values())
    if not ready:
        response.status_code = 503
        response.headers["Retry-After"] = "1"
    response.headers["Cache-Control"] = "no-store"
    return {"status": "ready" if ready else "not ready", "checks": checks}


def _queue(parts: Services) -> str:
    try:
        parts.probe.ping()
    except redis.RedisError:
        return "the queue server does not answer"
    return OK


def _store(parts: Services) -> str:
    try:
        parts.store.check()
    except StoreUnavailableError as error:
        return error.message
    except (OSError, SilhouetteError):
        return "the store cannot be written"
    return OK


def _renderer(parts: Services) -> str:
    if parts.renderer_fault is not None:
        return parts.renderer_fault
    return OK if parts.renderer.can_draw else "the renderer has stopped, or its GL is gone"


CHECKS: dict[str, Callable[[Services], str]] = {"queue": _queue, "store": _store, "renderer": _renderer}
"""Each thing a request needs: looks, blocking, and says "ok" or what is wrong with it."""
