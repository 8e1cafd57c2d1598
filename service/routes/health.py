"""Is the process alive, and can it do its work."""

from __future__ import annotations

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
def readyz(parts: Parts, response: Response) -> dict[str, Any]:
    """200 when a request would succeed: the queue answers, the store can be written, the renderer draws."""
    checks = check(parts)
    ready = all(answer == OK for answer in checks.values())
    if not ready:
        response.status_code = 503
        response.headers["Retry-After"] = "1"
    response.headers["Cache-Control"] = "no-store"
    return {"status": "ready" if ready else "not ready", "checks": checks}


def check(parts: Services) -> dict[str, str]:
    """Each thing a request needs: "ok", or what is wrong with it. Blocks."""
    return {"queue": _queue(parts), "store": _store(parts), "renderer": parts.renderer_fault or OK}


def _queue(parts: Services) -> str:
    try:
        parts.queue.redis.ping()
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
