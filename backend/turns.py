"""Turns of processes, kept in Redis: what one of them does, no other does meanwhile, nor any for a while after it."""

from __future__ import annotations

import logging
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Self

import redis
from redis.lock import Lock

log = logging.getLogger(__name__)

HELD_S = 30.0
"""A turn that nobody has renewed for so long is free: its holder is dead."""
RENEW_S = 10.0
FAILED_S = 60.0
"""What failed may be tried again so soon."""


class Turn:
    """A turn that was taken. It may be used in a child of the process that took it.

    A Redis that loses its data forgets turns, so what is done in one must bear being done twice at once.
    """

    def __init__(self, lock: Lock) -> None:
        self._lock = lock

    @classmethod
    def take(cls, connection: redis.Redis, name: str) -> Self | None:
        """The turn of this name (a key), or None while somebody has it, or had it a while ago. Raises redis.RedisError."""
        lock = Lock(connection, name, timeout=HELD_S, blocking=False, thread_local=False)
        return cls(lock) if lock.acquire() else None

    @contextmanager
    def held(self, pause_s: float) -> Iterator[None]:
        """Hold the turn as long as the block takes; then nobody has it for `pause_s` seconds, or FAILED_S at most if it raises."""
        ended = threading.Event()
        renewing = threading.Thread(target=self._renew, args=(ended,), name="turn", daemon=True)
        renewing.start()
        left_s = min(pause_s, FAILED_S)
        try:
            yield
            left_s = pause_s
        finally:
            ended.set()
            renewing.join()
            self._extend(left_s)

    def _renew(self, ended: threading.Event) -> None:
        while not ended.wait(RENEW_S):
            self._extend(HELD_S)

    def _extend(self, seconds: float) -> None:
        try:
            self._lock.extend(seconds, replace_ttl=True)
        except redis.RedisError as error:  # it runs out by itself, or Redis has forgotten it
            log.warning("turn not renewed: %s", error)
