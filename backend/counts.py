"""Counts of what workers did, kept in Redis, where any service can read them: workers come and go, and nobody scrapes them.

Losing them, or Redis with them, must not fail a stage: errors of Redis while counting end here.
"""

from __future__ import annotations

import logging
from collections import defaultdict
from dataclasses import dataclass, field
from typing import cast

import redis
from rq.registry import StartedJobRegistry

from backend.queue import JobQueue
from schemas.manifest import StageRecord

log = logging.getLogger(__name__)

BUCKETS_S = (0.1, 0.3, 1.0, 3.0, 10.0, 30.0, 100.0, 300.0, 1000.0)
"""Upper bounds of the histogram of stages, seconds; one more has the rest."""

_HASH = "silhouette:counts"
_STARTED, _ENDED, _SECONDS, _BUCKET = "started", "ended", "seconds", "bucket"


@dataclass
class StageCounts:
    """Of all workers since Redis began. started: stage -> times it was started. ended: (stage, outcome) -> times.

    seconds: stage -> of all together. buckets: stage -> stages within each bound of `BUCKETS_S`, and beyond, not summed.
    """

    started: dict[str, int] = field(default_factory=dict)
    ended: dict[tuple[str, str], int] = field(default_factory=dict)
    seconds: dict[str, float] = field(default_factory=dict)
    buckets: dict[str, list[int]] = field(default_factory=lambda: defaultdict(lambda: [0] * (len(BUCKETS_S) + 1)))


@dataclass(frozen=True)
class QueueDepth:
    """Jobs of one queue: those that wait, that workers run, and that were given up lately."""

    waiting: int
    running: int
    failed: int


def count_start(connection: redis.Redis, stage: str) -> None:
    """Count a stage that a worker begins."""
    try:
        connection.hincrby(_HASH, f"{_STARTED}:{stage}", 1)
    except redis.RedisError as error:
        log.warning("start not counted: %s", error)


def count_end(connection: redis.Redis, record: StageRecord) -> None:
    """Count a stage that has ended, and how long it took."""
    bucket = sum(bound < record.seconds for bound in BUCKETS_S)
    try:
        with connection.pipeline(transaction=True) as pipe:
            pipe.hincrby(_HASH, f"{_ENDED}:{record.stage}:{record.outcome}", 1)
            pipe.hincrbyfloat(_HASH, f"{_SECONDS}:{record.stage}", record.seconds)
            pipe.hincrby(_HASH, f"{_BUCKET}:{record.stage}:{bucket}", 1)
            pipe.execute()
    except redis.RedisError as error:
        log.warning("end not counted: %s", error)


def read_counts(connection: redis.Redis) -> StageCounts:
    """What has been counted. Raises redis.RedisError."""
    found = StageCounts()
    for key, value in cast(dict[bytes, bytes], connection.hgetall(_HASH)).items():
        kind, stage, *more = key.decode().split(":")
        if kind == _STARTED:
            found.started[stage] = int(value)
        elif kind == _ENDED:
            found.ended[stage, more[0]] = int(value)
        elif kind == _SECONDS:
            found.seconds[stage] = float(value)
        elif kind == _BUCKET:
            found.buckets[stage][int(more[0])] = int(value)
    return found


def queue_depths(connection: redis.Redis, jobs: JobQueue) -> dict[str, QueueDepth]:
    """By name of the queue, asked for in one go over `connection`. Raises redis.RedisError."""
    queues = (jobs.queue, jobs.later, jobs.once)
    with connection.pipeline(transaction=False) as pipe:
        for queue in queues:
            pipe.llen(queue.key)
            pipe.zcard(StartedJobRegistry(queue=queue).key)
            pipe.zcard(queue.failed_job_registry.key)
        answers = pipe.execute()
    return {queue.name: QueueDepth(*answers[3 * number : 3 * number + 3]) for number, queue in enumerate(queues)}
