"""The job queue: RQ on Redis, filled from the store.

The store says what is to be done: a stage is due when the stages before it have a record and it has none. Redis only carries
that to the workers, so any loss of it is made good by `reconcile`. A job's id is its mesh and stage, so enqueueing twice is
nothing; running twice writes the same bytes.
"""

from __future__ import annotations

import contextlib
import logging
import time
from enum import Enum
from typing import cast

import redis
from redis.backoff import ConstantBackoff
from redis.retry import Retry as RedisRetry
from rq import Queue, Retry
from rq.exceptions import DuplicateJobError
from rq.job import Job, JobStatus
from rq.registry import StartedJobRegistry
from rq.serializers import JSONSerializer

from backend import records
from backend.manifests import build_manifest, failed_record
from backend.problems import BROKEN, problem_of
from backend.progress import Progress
from backend.settings import BackendSettings
from backend.store import Store
from schemas import keys
from schemas.errors import CancelledError, SilhouetteError
from schemas.jobs import LATER_STAGES, QUEUE, RUN_STAGE, STAGES
from schemas.manifest import StageRecord

log = logging.getLogger(__name__)

SOCKET_TIMEOUT_S = 15.0  # longer than a worker's blocking wait for a job
MAINTENANCE_LOCK_S = 10  # a killed worker must not keep the others from maintenance for long
RESULT_S = 60
LAST_STAGE = list(LATER_STAGES)[-1]
RECONCILE_LOCK = "silhouette:reconciling"


def connect(url: str) -> redis.Redis:
    """A connection pool for `redis://`, `rediss://` or `unix://`. One quick second try, then errors are the caller's."""
    retry = RedisRetry(ConstantBackoff(0.05), 1)
    return redis.Redis.from_url(url, socket_timeout=SOCKET_TIMEOUT_S, socket_connect_timeout=5.0, retry=retry)


class StageQueue(Queue):
    """RQ's queue, but a worker that is killed during maintenance blocks it for seconds, not for 15 minutes."""

    def acquire_maintenance_lock(self) -> bool:
        """Whether this worker may clean the registries now."""
        return bool(self.connection.set(self.registry_cleaning_key, 1, nx=True, ex=MAINTENANCE_LOCK_S))


class _JobState(Enum):
    ABSENT = "absent"
    ALIVE = "alive"
    OVER = "over"  # ended, or lost by a Redis that forgot a part
    GAVE_UP = "gave up"


class JobQueue:
    """Jobs of all meshes. `attempts` is how often a stage is started when it breaks or its worker dies; measure: whether meshes that are
    ready go on to the later stages.
    """

    def __init__(
        self,
        connection: redis.Redis,
        store: Store,
        *,
        stage_timeout_s: int = 3600,
        attempts: int = 4,
        job_record_s: int = 3600,
        measure: bool = False,
    ) -> None:
        self.redis = connection
        self.store = store
        self.progress = Progress(connection)
        self.queue = StageQueue(QUEUE, connection=connection, serializer=JSONSerializer)
        self._stage_timeout_s = stage_timeout_s
        self._attempts = attempts
        self._job_record_s = job_record_s
        self._measure = measure

    @classmethod
    def open(cls, settings: BackendSettings) -> JobQueue:
        """The queue and store that the settings name. Raises ValueError without a Redis URL."""
        if settings.redis_url is None:
            raise ValueError("SILHOUETTE_REDIS_URL is not set")
        return cls(
            connect(settings.redis_url),
            Store(settings.store_dir),
            stage_timeout_s=settings.stage_timeout_s,
            attempts=settings.stage_attempts,
            job_record_s=settings.job_record_s,
            measure=settings.measure,
        )

    def advance(self, mesh_id: str) -> None:
        """Bring a mesh forward from what the store says: enqueue the stages that are due, or end it with its manifest.

        One that is ready goes on to the later stages, when nothing else is waiting. Does nothing for a mesh that is deleted or has
        failed. Raises redis.RedisError, StorageFullError.
        """
        if not records.is_accepted(self.store, mesh_id):
            return
        if self.store.exists(keys.manifest(mesh_id)):
            self._advance_later(mesh_id)
            return
        done = {stage: records.read_stage(self.store, mesh_id, stage) for stage in STAGES}
        if _ended(done):
            self._finish(mesh_id)
            return
        due = [stage for stage, before in STAGES.items() if done[stage] is None and all(done[name] for name in before)]
        for stage in due:
            if self._enqueue(mesh_id, stage) is _JobState.GAVE_UP:
                self._give_up(mesh_id, stage)
                return

    def reconcile(self) -> int:
        """Advance every accepted mesh that has something to be done; how many there are. Run at start and every few seconds."""
        count = 0
        for mesh_id in records.unfinished(self.store, LAST_STAGE if self._measure else None):
            count += 1
            try:
                self.advance(mesh_id)
            except SilhouetteError:  # one mesh must not keep the others waiting
                log.exception("mesh cannot be advanced", extra={"mesh": mesh_id})
        return count

    def reconcile_in_turn(self, interval_s: float) -> None:
        """`reconcile`, unless some process has done so within the last `interval_s`."""
        if self.redis.set(RECONCILE_LOCK, 1, nx=True, px=max(1, int(interval_s * 1000))):
            self.reconcile()

    def others_wait(self) -> bool:
        """Whether a stage waits for a worker that is not a later one."""
        waiting = cast(list[bytes], self.redis.lrange(self.queue.key, 0, -1))
        return any(job_id.decode().rpartition("-")[2] in STAGES for job_id in waiting)

    def cancel(self, mesh_id: str) -> bool:
        """Delete a mesh: its acceptance, files and waiting jobs. False when there was no such mesh.

        A stage that is running stops at its next report of progress and cannot write any more. Once the store has forgotten
        the mesh it is deleted, whatever becomes of Redis.
        """
        existed = records.forget(self.store, mesh_id)
        try:
            self._drop_jobs(mesh_id)
        except redis.RedisError as error:  # its jobs find nothing to do
            log.warning("jobs not cancelled: %s", error, extra={"mesh": mesh_id})
        self.progress.clear(mesh_id)
        self.progress.notify(mesh_id)
        return existed

    def restart_abandoned(self) -> None:
        """Start the jobs again whose workers are gone. Only for the owner of all workers, before it starts any."""
        self._started().cleanup(timestamp=time.time() + 1e9)
        self._return_taken()

    def release_started(self) -> None:
        """Forget the jobs that were stopped on purpose, so that it does not count as an attempt. All workers must be gone."""
        for entry in self._started_entries():
            self.redis.zrem(self._started().key, entry)
            self._delete_job(entry.partition(":")[0])
        self._return_taken()

    def _return_taken(self) -> None:
        """Put back what a worker had taken but not begun; RQ itself waits for a minute."""
        taken = self.queue.intermediate_queue_key
        for job_id in cast(list[bytes], self.redis.lrange(taken, 0, -1)):
            with self.redis.pipeline(transaction=True) as pipe:
                pipe.lrem(taken, 0, job_id.decode())
                pipe.lrem(self.queue.key, 0, job_id.decode())
                pipe.lpush(self.queue.key, job_id)
                pipe.execute()

    def _finish(self, mesh_id: str) -> None:
        with contextlib.suppress(CancelledError), records.publishing(self.store, mesh_id):
            done = {stage: records.read_stage(self.store, mesh_id, stage) for stage in STAGES}
            manifest = build_manifest(mesh_id, done)
            if records.write_manifest(self.store, manifest):
                log.info("mesh is %s", manifest.status, extra={"mesh": mesh_id})
        self._drop_jobs(mesh_id)
        self.progress.clear(mesh_id)
        self.progress.notify(mesh_id)
        self._advance_later(mesh_id)

    def _advance_later(self, mesh_id: str) -> None:
        """Enqueue the later stages of a ready mesh that are due; those before them may have failed."""
        manifest = records.read_manifest(self.store, mesh_id) if self._measure else None
        if manifest is None or manifest.status != "ready":
            return
        done = {stage: records.read_stage(self.store, mesh_id, stage) for stage in LATER_STAGES}
        if all(done.values()):
            self.progress.clear(mesh_id)
            return
        if self.others_wait():
            return
        due = [s for s, before in LATER_STAGES.items() if done[s] is None and all(done[name] for name in before if name in done)]
        for stage in due:
            if self._enqueue(mesh_id, stage) is _JobState.GAVE_UP:
                self._give_up(mesh_id, stage)
                return

    def _give_up(self, mesh_id: str, stage: str) -> None:
        with contextlib.suppress(CancelledError), records.publishing(self.store, mesh_id):
            if records.read_stage(self.store, mesh_id, stage) is None:
                records.write_stage(self.store, mesh_id, failed_record(stage, 0.0, problem_of(BROKEN)))
        self.advance(mesh_id)

    def _enqueue(self, mesh_id: str, stage: str) -> _JobState:
        job_id = f"{mesh_id}-{stage}"
        state = self._state(job_id)
        if state in (_JobState.ALIVE, _JobState.GAVE_UP):
            return state
        if state is _JobState.OVER and not self._remove_over(job_id):
            return _JobState.ALIVE
        with contextlib.suppress(DuplicateJobError):
            self.queue.enqueue(
                RUN_STAGE,
                args=(mesh_id, stage),
                job_id=job_id,
                unique=True,
                retry=Retry(max=self._attempts - 1) if self._attempts > 1 else None,
                job_timeout=self._stage_timeout_s,
                result_ttl=RESULT_S,
                failure_ttl=self._job_record_s,
                description=f"{stage} of {mesh_id}",
            )
            log.info("enqueued", extra={"mesh": mesh_id, "stage": stage})
        return _JobState.ALIVE

    def _state(self, job_id: str) -> _JobState:
        """One look, in one transaction: RQ moves a living job between the three places atomically."""
        with self.redis.pipeline(transaction=True) as pipe:
            pipe.hget(Job.key_for(job_id), "status")
            pipe.lpos(self.queue.key, job_id)
            pipe.lpos(self.queue.intermediate_queue_key, job_id)
            pipe.zrange(self._started().key, 0, -1)
            status, waiting, taken, running = pipe.execute()
        if status is None:
            return _JobState.ABSENT
        if status.decode() == JobStatus.FAILED:
            return _JobState.GAVE_UP
        is_running = any(entry.decode().partition(":")[0] == job_id for entry in running)
        return _JobState.ALIVE if waiting is not None or taken is not None or is_running else _JobState.OVER

    def _remove_over(self, job_id: str) -> bool:
        """Remove a job that is over, unless someone else has just changed it."""
        key = Job.key_for(job_id)
        with self.redis.pipeline(transaction=True) as pipe:
            pipe.watch(key)
            if self._state(job_id) is not _JobState.OVER:
                return False
            pipe.multi()
            pipe.delete(key)
            try:
                pipe.execute()
            except redis.WatchError:
                return False
        return True

    def _drop_jobs(self, mesh_id: str) -> None:
        """Remove the jobs of a mesh that no worker has started."""
        running = {entry.partition(":")[0] for entry in self._started_entries()}
        for stage in (*STAGES, *LATER_STAGES):
            if f"{mesh_id}-{stage}" not in running:
                self._delete_job(f"{mesh_id}-{stage}")

    def _delete_job(self, job_id: str) -> None:
        with self.redis.pipeline(transaction=True) as pipe:
            pipe.lrem(self.queue.key, 0, job_id)
            pipe.zrem(self.queue.failed_job_registry.key, job_id)
            pipe.zrem(self.queue.finished_job_registry.key, job_id)
            pipe.delete(Job.key_for(job_id))
            pipe.execute()

    def _started(self) -> StartedJobRegistry:
        return StartedJobRegistry(queue=self.queue)

    def _started_entries(self) -> list[str]:
        entries = cast(list[bytes], self.redis.zrange(self._started().key, 0, -1))
        return [entry.decode() for entry in entries]


def _ended(done: dict[str, StageRecord | None]) -> bool:
    return all(done.values()) or any(record is not None and record.outcome == "failed" for record in done.values())
