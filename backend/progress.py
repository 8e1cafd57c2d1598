"""How far the running stages are: a hash in Redis that expires, and a message on a channel at each change.

Progress is a convenience. Losing it, or Redis with it, must not fail a stage: errors of Redis end here.
"""

from __future__ import annotations

import logging
import time
from typing import cast

import redis

log = logging.getLogger(__name__)

KEEP_S = 24 * 3600
INTERVAL_S = 0.25  # between two reports of one stage, unless it starts or ends
_HASH = "silhouette:progress:{}"
_CHANNEL = "silhouette:changes:{}"


class Progress:
    """Progress of the stages of all meshes. One instance a process."""

    def __init__(self, connection: redis.Redis) -> None:
        self._redis = connection
        self._last: dict[tuple[str, str], float] = {}

    def report(self, mesh_id: str, stage: str, fraction: float) -> None:
        """Say that a stage is at `fraction`, 0 to 1. Most calls in quick succession do nothing."""
        now = time.monotonic()
        if 0.0 < fraction < 1.0 and now - self._last.get((mesh_id, stage), -INTERVAL_S) < INTERVAL_S:
            return
        self._last[mesh_id, stage] = now
        key = _HASH.format(mesh_id)
        try:
            with self._redis.pipeline(transaction=False) as pipe:
                pipe.hset(key, stage, f"{min(max(fraction, 0.0), 1.0):.4f}")
                pipe.expire(key, KEEP_S)
                pipe.publish(self.channel(mesh_id), stage)
                pipe.execute()
        except redis.RedisError as error:
            log.warning("progress not reported: %s", error, extra={"mesh": mesh_id, "stage": stage})

    def notify(self, mesh_id: str) -> None:
        """Tell listeners that something about the mesh has changed in the store."""
        try:
            self._redis.publish(self.channel(mesh_id), "")
        except redis.RedisError as error:
            log.warning("change not announced: %s", error, extra={"mesh": mesh_id})

    def read(self, mesh_id: str) -> dict[str, float]:
        """Stages that have started, with their fractions; empty when nothing is known."""
        try:
            found = cast(dict[bytes, bytes], self._redis.hgetall(_HASH.format(mesh_id)))
        except redis.RedisError as error:
            log.warning("progress not read: %s", error, extra={"mesh": mesh_id})
            return {}
        return {stage.decode(): float(fraction) for stage, fraction in found.items()}

    def clear(self, mesh_id: str) -> None:
        """Forget what is known of a mesh."""
        try:
            self._redis.delete(_HASH.format(mesh_id))
        except redis.RedisError as error:
            log.warning("progress not cleared: %s", error, extra={"mesh": mesh_id})

    @staticmethod
    def channel(mesh_id: str) -> str:
        """Channel on which the name of a stage, or nothing, is published at each change of a mesh."""
        return _CHANNEL.format(mesh_id)
