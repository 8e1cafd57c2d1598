"""Jobs of RQ: one for a stage of a mesh, whose id is those two, so that enqueueing twice is nothing.

What is due is not known here (`backend.queue`), but what has become of what was enqueued: whether it waits, is in a worker's hands, is
over, lost, or was started as often as it may be. Stages of a mesh that is ready wait in a queue of their own, behind all others.
"""

from __future__ import annotations

import contextlib
import logging
import math
import time
from collections.abc import Collection, Sequence
from enum import Enum
from typing import Any, cast

import redis
from rq import Queue, Retry
from rq.exceptions import DequeueTimeout, DuplicateJobError
from rq.intermediate_queue import IntermediateQueue
from rq.job import Job, JobStatus
from rq.registry import StartedJobRegistry
from rq.serializers import JSONSerializer

from backend.tracing import carried
from schemas.jobs import LATER_QUEUE, LATER_STAGES, QUEUE, RUN_STAGE

log = logging.getLogger(__name__)

MAINTENANCE_LOCK_S = 10  # a killed worker must not keep the others from maintenance for long
LATER_LOOK_S = 1  # an idle worker waits for the first queue, and looks into the other one as often as this
RESULT_S = 60


class StageQueue(Queue):
    """RQ's queue, but a worker that is killed blocks it for seconds only, and loses no job that it took from one of several."""

    def acquire_maintenance_lock(self) -> bool:
        """Whether this worker may clean the registries now; one that dies keeps the others from it for seconds, not for 15 minutes."""
        return bool(self.connection.set(self.registry_cleaning_key, 1, nx=True, ex=MAINTENANCE_LOCK_S))

    @classmethod
    def lpop(cls, queue_keys: Sequence[str], timeout: int | None, connection: Any = None) -> tuple[str, bytes] | None:
        """Take the next job of the first queue that has one, as (queue key, job id); the job waits in that queue's intermediate list.

        RQ's own has it nowhere until it is started. timeout: seconds to wait; None: do not. Raises DequeueTimeout.
        """
        deadline = time.monotonic() + (timeout or 0)
        while True:
            for key in queue_keys:
                if taken := cls.lmove(connection, key, None):
                    return cast(tuple[str, bytes], taken)
            left = deadline - time.monotonic()
            if timeout is None:
                return None
            if left <= 0.0:
                raise DequeueTimeout(timeout, queue_keys)
            with contextlib.suppress(DequeueTimeout):
                return cast(tuple[str, bytes], cls.lmove(connection, queue_keys[0], min(LATER_LOOK_S, math.ceil(left))))


class JobState(Enum):
    """What has become of a stage's job."""

    ABSENT = "absent"
    ALIVE = "alive"
    OVER = "over"  # ended, or lost by a Redis that forgot a part
    GAVE_UP = "gave up"


class StageJobs:
    """Jobs of the stages of all meshes. `attempts` is how often a stage is started when it breaks or its worker dies.

    `queue` and `later` are what workers listen to, in that order.
    """

    def __init__(self, connection: redis.Redis, *, stage_timeout_s: int, attempts: int, job_record_s: int) -> None:
        self.redis = connection
        self.queue = StageQueue(QUEUE, connection=connection, serializer=JSONSerializer)
        self.later = StageQueue(LATER_QUEUE, connection=connection, serializer=JSONSerializer)
        self._stage_timeout_s = stage_timeout_s
        self._attempts = attempts
        self._job_record_s = job_record_s

    def enqueue(self, mesh_id: str, stage: str) -> JobState:
        """Enqueue a stage of a mesh unless it has a job; the state it then has: ALIVE, or GAVE_UP when it is to be started no more."""
        queue, job_id = self._queue_of(stage), f"{mesh_id}-{stage}"
        state = self._state(queue, job_id)
        if state in (JobState.ALIVE, JobState.GAVE_UP):
            return state
        if state is JobState.OVER and not self._remove_over(queue, job_id):
            return JobState.ALIVE
        with contextlib.suppress(DuplicateJobError):
            queue.enqueue(
                RUN_STAGE,
                args=(mesh_id, stage),
                job_id=job_id,
                unique=True,
                retry=Retry(max=self._attempts - 1) if self._attempts > 1 else None,
                job_timeout=self._stage_timeout_s,
                result_ttl=RESULT_S,
                failure_ttl=self._job_record_s,
                description=f"{stage} of {mesh_id}",
                meta=carried(),
            )
            log.info("enqueued", extra={"mesh": mesh_id, "stage": stage})
        return JobState.ALIVE

    def drop(self, mesh_id: str, stages: Collection[str]) -> None:
        """Remove the jobs of a mesh that no worker has started, and of all what RQ notes of those on their way to one."""
        running = {entry.partition(":")[0] for queue in self._queues for entry in started_entries(queue)}
        for stage in stages:
            queue, job_id = self._queue_of(stage), f"{mesh_id}-{stage}"
            if job_id not in running:
                self._delete_job(queue, job_id)
            self.redis.delete(IntermediateQueue(queue.key, self.redis).get_first_seen_key(job_id))

    def restart_abandoned(self) -> None:
        """Start the jobs again whose workers are gone. Only for the owner of all workers, before it starts any."""
        for queue in self._queues:
            started_registry(queue).cleanup(timestamp=time.time() + 1e9)
        self._return_taken()

    def release_started(self) -> None:
        """Forget the jobs that were stopped on purpose, so that it does not count as an attempt. All workers must be gone."""
        for queue in self._queues:
            for entry in started_entries(queue):
                self.redis.zrem(started_registry(queue).key, entry)
                self._delete_job(queue, entry.partition(":")[0])
        self._return_taken()

    def _return_taken(self) -> None:
        """Put back what a worker had taken but not begun; RQ itself waits for a minute."""
        for queue in self._queues:
            taken = queue.intermediate_queue_key
            for job_id in cast(list[bytes], self.redis.lrange(taken, 0, -1)):
                with self.redis.pipeline(transaction=True) as pipe:
                    pipe.lrem(taken, 0, job_id.decode())
                    pipe.lrem(queue.key, 0, job_id.decode())
                    pipe.lpush(queue.key, job_id)
                    pipe.execute()

    def _state(self, queue: StageQueue, job_id: str) -> JobState:
        """One look, in one transaction: RQ moves a living job between the three places atomically."""
        with self.redis.pipeline(transaction=True) as pipe:
            pipe.hget(Job.key_for(job_id), "status")
            pipe.lpos(queue.key, job_id)
            pipe.lpos(queue.intermediate_queue_key, job_id)
            pipe.zrange(started_registry(queue).key, 0, -1)
            status, waiting, taken, running = pipe.execute()
        if status is None:
            return JobState.ABSENT
        if status.decode() == JobStatus.FAILED:
            return JobState.GAVE_UP
        is_running = any(entry.decode().partition(":")[0] == job_id for entry in running)
        return JobState.ALIVE if waiting is not None or taken is not None or is_running else JobState.OVER

    def _remove_over(self, queue: StageQueue, job_id: str) -> bool:
        """Remove a job that is over, unless someone else has just changed it."""
        key = Job.key_for(job_id)
        with self.redis.pipeline(transaction=True) as pipe:
            pipe.watch(key)
            if self._state(queue, job_id) is not JobState.OVER:
                return False
            pipe.multi()
            pipe.delete(key)
            try:
                pipe.execute()
            except redis.WatchError:
                return False
        return True

    def _delete_job(self, queue: StageQueue, job_id: str) -> None:
        with self.redis.pipeline(transaction=True) as pipe:
            pipe.lrem(queue.key, 0, job_id)
            pipe.zrem(queue.failed_job_registry.key, job_id)
            pipe.zrem(queue.finished_job_registry.key, job_id)
            pipe.delete(Job.key_for(job_id))
            pipe.execute()

    @property
    def _queues(self) -> tuple[StageQueue, StageQueue]:
        return self.queue, self.later

    def _queue_of(self, stage: str) -> StageQueue:
        return self.later if stage in LATER_STAGES else self.queue


def started_registry(queue: StageQueue) -> StartedJobRegistry:
    """RQ's registry of the jobs that workers run."""
    return StartedJobRegistry(queue=queue)


def started_entries(queue: StageQueue) -> list[str]:
    """What is in it: ids of jobs, each with a colon and the id of its execution."""
    entries = cast(list[bytes], queue.connection.zrange(started_registry(queue).key, 0, -1))
    return [entry.decode() for entry in entries]
