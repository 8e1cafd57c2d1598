"""How much a key, or an address of a service without keys, may ask.

Requests a minute are counted in Redis for all processes together, pictures in work at once in this one.
"""

from __future__ import annotations

import logging
import math
import time
from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import redis
from limits import RateLimitItemPerMinute
from limits.aio.storage import MemoryStorage, RedisStorage
from limits.aio.strategies import MovingWindowRateLimiter
from redis.asyncio import ConnectionPool

from schemas.errors import QuotaError

log = logging.getLogger("silhouette.access")

PREFIX = "silhouette:requests"
SOCKET_TIMEOUT_S = 0.5
"""A request waits no longer for its being counted."""

AWAY_S = 5.0
"""Seconds for which a Redis that did not answer is not asked again."""

RENDER_RETRY_S = 1.0


@dataclass(frozen=True)
class Counted:
    """A request that was counted: how many a minute there may be, how many are left, seconds until one more is."""

    limit: int
    left: int
    reset_s: float

    def headers(self) -> dict[str, str]:
        """The same for the client (draft-ietf-httpapi-ratelimit-headers, in the form that most clients read)."""
        reset = str(max(0, math.ceil(self.reset_s)))
        return {"RateLimit-Limit": str(self.limit), "RateLimit-Remaining": str(self.left), "RateLimit-Reset": reset}


class OverRateError(QuotaError):
    """Too many requests a minute; `counted` says when to come again."""

    def __init__(self, counted: Counted) -> None:
        told = f"You have {counted.limit} requests a minute, and they are used up."
        super().__init__(told, retry_after_s=counted.reset_s, quota="requests_per_minute", limit=counted.limit)
        self.counted = counted


class RequestQuota:
    """Counts requests in a window of the last minute.

    While Redis is away each process counts for itself: neither is everything let through then nor everything refused. To be made
    and used in one event loop.
    """

    def __init__(self, redis_url: str, options: Mapping[str, Any] | None = None) -> None:
        times = {"socket_timeout": SOCKET_TIMEOUT_S, "socket_connect_timeout": SOCKET_TIMEOUT_S}
        self._pool = ConnectionPool.from_url(redis_url, **times, **(options or {}))
        storage = RedisStorage("async+redis://", implementation="redispy", key_prefix=PREFIX, connection_pool=self._pool)  # type: ignore[arg-type]
        self._shared = MovingWindowRateLimiter(storage)
        self._own = MovingWindowRateLimiter(MemoryStorage())
        self._away_until = 0.0

    async def count(self, owner: str, per_minute: int) -> Counted:
        """Count a request of a key or address. Raises OverRateError when it is one too many, which is not counted."""
        if time.monotonic() >= self._away_until:
            try:
                return await _count(self._shared, owner, per_minute)
            except redis.RedisError as error:
                log.warning("requests are counted in this process alone: %s", type(error).__name__)
                self._away_until = time.monotonic() + AWAY_S
        return await _count(self._own, owner, per_minute)

    async def close(self) -> None:
        """Close the connections."""
        await self._pool.aclose()


async def _count(limiter: MovingWindowRateLimiter, owner: str, per_minute: int) -> Counted:
    item = RateLimitItemPerMinute(per_minute)
    is_within = await limiter.hit(item, owner)
    stats = await limiter.get_window_stats(item, owner)
    counted = Counted(per_minute, stats.remaining, stats.reset_time - time.time())
    if not is_within:
        raise OverRateError(counted)
    return counted


class RenderQuota:
    """Pictures in work, by key or address. For one event loop."""

    def __init__(self) -> None:
        self._running: Counter[str] = Counter()

    @contextmanager
    def one_more(self, owner: str, most: int | None) -> Iterator[None]:
        """Count one inside the block. Raises QuotaError when there are as many as there may be."""
        if most is not None and self._running[owner] >= most:
            told = f"You may have {most} {'picture' if most == 1 else 'pictures'} in work at once."
            raise QuotaError(told, retry_after_s=RENDER_RETRY_S, quota="concurrent_renders", limit=most)
        self._running[owner] += 1
        try:
            yield
        finally:
            self._running[owner] -= 1
            if not self._running[owner]:
                del self._running[owner]
