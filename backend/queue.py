"""The job queue: RQ on Redis, filled from the store.

The store says what is to be done: a stage is due when the stages before it have a record and it has none. Redis only carries
that to the workers, so any loss of it is made good by `reconcile`. A job's id is its mesh and stage, so enqueueing twice is
nothing; running twice writes the same bytes. Stages of a mesh that is ready wait in a queue of their own, behind all others.
"""

from __future__ import annotations

import contextlib
import logging
import math
import time
from collections.abc import Collection, Iterator, Mapping, Sequence
from enum import Enum
from pathlib import Path
from typing import Any, cast

import redis
from redis.backoff import ConstantBackoff
from redis.retry import Retry as RedisRetry
from rq import Queue, Retry
from rq.exceptions import DequeueTimeout, DuplicateJobError
from rq.intermediate_queue import IntermediateQueue
from rq.job import Job, JobStatus
from rq.registry import StartedJobRegistry
from rq.serializers import JSONSerializer

from backend import records
from backend.damage import drop_damaged
from backend.manifests import build_manifest, failed_record
from backend.problems import BROKEN, problem_of
from backend.progress import Progress
from backend.settings import BackendSettings
from backend.store import Store
from backend.stores import open_store
from backend.tracing import carried
from schemas import keys
from schemas.errors import CancelledError, DamagedArtifactError, SilhouetteError
from schemas.jobs import LATER_QUEUE, LATER_STAGES, ONCE_QUEUE, QUEUE, READ_MESH, RUN_STAGE, STAGES
from schemas.manifest import StageRecord

log = logging.getLogger(__name__)

SOCKET_TIMEOUT_S = 15.0  # longer than a worker's blocking wait for a job
MAINTENANCE_LOCK_S = 10  # a killed worker must not keep the others from maintenance for long
LATER_LOOK_S = 1  # an idle worker waits for the first queue, and looks into the other one as often as this
RESULT_S = 60
RECONCILE_LOCK = "silhouette:reconciling"


def connect(
    url: str, password_file: Path | None = None, ca_file: Path | None = None, *, timeout_s: float = SOCKET_TIMEOUT_S
) -> redis.Redis:
    """A connection pool for `redis://`, `rediss://` or `unix://`. One quick second try, then errors are the caller's.

    password_file: its first line is the password. ca_file: certificates that the server's is to be signed by, instead of the system's.
    timeout_s: longest that one answer is waited for.
    """
    retry = RedisRetry(ConstantBackoff(0.05), 1)
    more = connection_options(url, password_file, ca_file)
    return redis.Redis.from_url(url, socket_timeout=timeout_s, socket_connect_timeout=min(timeout_s, 5.0), retry=retry, **more)


def connection_options(url: str, password_file: Path | None, ca_file: Path | None) -> dict[str, Any]:
    """What any of redis-py's connections is to be told besides the URL."""
    options: dict[str, Any] = {}
    if password_file is not None:
        options["password"] = password_file.read_text().partition("\n")[0].strip()
    if ca_file is not None and url.startswith("rediss://"):
        options["ssl_ca_certs"] = str(ca_file)
    return options


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


class _JobState(Enum):
    ABSENT = "absent"
    ALIVE = "alive"
    OVER = "over"  # ended, or lost by a Redis that forgot a part
    GAVE_UP = "gave up"


class JobQueue:
    """Jobs of all meshes. `attempts` is how often a stage is started when it breaks or its worker dies.

    `measure`: whether meshes that are ready go through the later stages. `queue` and `later` are what workers listen to, in that order,
    `once` what readers listen to.
    """

    def __init__(
        self,
        connection: redis.Redis,
        store: Store,
        *,
        measure: bool = False,
        stage_timeout_s: int = 3600,
        attempts: int = 4,
        job_record_s: int = 3600,
    ) -> None:
        self.redis = connection
        self.store = store
        self.measure = measure
        self.progress = Progress(connection)
        self.queue = StageQueue(QUEUE, connection=connection, serializer=JSONSerializer)
        self.later = StageQueue(LATER_QUEUE, connection=connection, serializer=JSONSerializer)
        self.once = StageQueue(ONCE_QUEUE, connection=connection, serializer=JSONSerializer)
        self._settled: dict[str, str] = {}
        self._stage_timeout_s = stage_timeout_s
        self._attempts = attempts
        self._job_record_s = job_record_s

    @classmethod
    def open(cls, settings: BackendSettings) -> JobQueue:
        """The queue and store that the settings name. Raises ValueError without a Redis URL."""
        if settings.redis_url is None:
            raise ValueError("SILHOUETTE_REDIS_URL is not set")
        return cls(
            connect(settings.redis_url, settings.redis_password_file, settings.redis_ca_file),
            open_store(settings),
            measure=settings.measure,
            stage_timeout_s=settings.stage_timeout_s,
            attempts=settings.stage_attempts,
            job_record_s=settings.job_record_s,
        )

    def advance(self, mesh_id: str) -> None:
        """Bring a mesh forward from what the store says: enqueue the stages that are due, or end it with its manifest.

        A mesh that is ready goes on with the later stages where `measure` is on. Does nothing for a mesh that is deleted or failed.
        Raises redis.RedisError, StorageFullError.
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
        self._enqueue_due(mesh_id, STAGES, done)

    def reconcile(self) -> int:
        """Advance every accepted mesh that has stages to go; how many there are. Run at start and every few seconds."""
        count = 0
        for mesh_id in self._unsettled():
            count += 1
            try:
                self.advance(mesh_id)
            except DamagedArtifactError:
                self.rebuild(mesh_id)
            except SilhouetteError:  # one mesh must not keep the others waiting
                log.exception("mesh cannot be advanced", extra={"mesh": mesh_id})
        return count

    def reconcile_in_turn(self, interval_s: float) -> None:
        """`reconcile`, unless some process has done so within the last `interval_s`."""
        if self.has_turn(interval_s):
            self.reconcile()

    def has_turn(self, interval_s: float) -> bool:
        """Whether nobody has had the turn to reconcile within the last `interval_s`; it is the caller's then. Raises redis.RedisError."""
        return bool(self.redis.set(RECONCILE_LOCK, 1, nx=True, px=max(1, int(interval_s * 1000))))

    def cancel(self, mesh_id: str) -> bool:
        """Delete a mesh: its acceptance, files and waiting jobs. False when there was no such mesh.

        A stage that is running stops at its next report of progress and cannot write any more. Once the store has forgotten
        the mesh it is deleted, whatever becomes of Redis.
        """
        existed = records.forget(self.store, mesh_id)
        try:
            self._drop_jobs(mesh_id, (*STAGES, *LATER_STAGES))
        except redis.RedisError as error:  # its jobs find nothing to do
            log.warning("jobs not cancelled: %s", error, extra={"mesh": mesh_id})
        self.progress.clear(mesh_id)
        self.progress.notify(mesh_id)
        return existed

    def rebuild(self, mesh_id: str) -> list[str]:
        """Run the stages of a mesh again whose files are damaged; their names. Nothing of a mesh that is deleted or sound."""
        dropped: list[str] = []
        with contextlib.suppress(CancelledError):
            dropped = drop_damaged(self.store, mesh_id)
        try:
            self.advance(mesh_id)
        except redis.RedisError as error:  # the reconciler will do it
            log.warning("stages not enqueued: %s", error, extra={"mesh": mesh_id})
        return dropped

    def read_once(self, token: str, extension: str, options: Mapping[str, Any], limit_s: float) -> None:
        """Have a mesh read that is not kept (`backend.once`), in so many seconds from now or never. Raises redis.RedisError."""
        self.once.enqueue(
            READ_MESH,
            args=(token, extension, dict(options)),
            job_id=f"{token}-once",
            job_timeout=math.ceil(limit_s),
            ttl=math.ceil(limit_s),
            result_ttl=0,
            failure_ttl=RESULT_S,
            description=f"read {token}",
            meta=carried(),
        )

    def has_waiting(self) -> bool:
        """Whether a job that makes a mesh ready waits for a worker; False when Redis does not say."""
        try:
            return bool(self.queue.count)
        except redis.RedisError as error:
            log.warning("waiting jobs not counted: %s", error)
            return False

    def restart_abandoned(self) -> None:
        """Start the jobs again whose workers are gone. Only for the owner of all workers, before it starts any."""
        for queue in self._queues:
            _started(queue).cleanup(timestamp=time.time() + 1e9)
        self._return_taken()

    def release_started(self) -> None:
        """Forget the jobs that were stopped on purpose, so that it does not count as an attempt. All workers must be gone."""
        for queue in self._queues:
            for entry in _started_entries(queue):
                self.redis.zrem(_started(queue).key, entry)
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

    def _unsettled(self) -> Iterator[str]:
        """Ids of accepted meshes that have stages to go. What has none is remembered by its manifest."""
        settled: dict[str, str] = {}
        for mesh_id, found in records.outlines(self.store):
            version = found.get(keys.MANIFEST)
            if version is not None and (not self.measure or self._settled.get(mesh_id) == version or self._is_settled(mesh_id, found)):
                settled[mesh_id] = version
            elif keys.ACCEPTED in found:
                yield mesh_id
        self._settled = settled

    def _is_settled(self, mesh_id: str, found: Collection[str]) -> bool:
        """Whether an ended mesh, of which these records were found, has failed or been through the later stages."""
        if all(keys.stage_name(stage) in found for stage in LATER_STAGES):
            return True
        try:
            manifest = records.read_manifest(self.store, mesh_id)
        except DamagedArtifactError:
            return False
        return manifest is not None and manifest.status == "failed"

    def _advance_later(self, mesh_id: str) -> None:
        """Enqueue the later stages of a ready mesh that are due. What comes after one that failed is skipped."""
        manifest = records.read_manifest(self.store, mesh_id) if self.measure else None
        if manifest is None or manifest.status != "ready":
            return
        done = {record.stage: record for record in manifest.stages}
        done |= {stage: record for stage in LATER_STAGES if (record := records.read_stage(self.store, mesh_id, stage))}
        for stage, before in LATER_STAGES.items():
            if stage not in done and any(name in done and done[name].outcome == "failed" for name in before):
                done[stage] = StageRecord(stage=stage, outcome="skipped", seconds=0.0)
                self._record(mesh_id, done[stage])
        self._enqueue_due(mesh_id, LATER_STAGES, done)
        if all(stage in done for stage in LATER_STAGES):
            self.progress.clear(mesh_id)
            self.progress.notify(mesh_id)

    def _enqueue_due(self, mesh_id: str, stages: Mapping[str, tuple[str, ...]], done: Mapping[str, StageRecord | None]) -> None:
        for stage, before in stages.items():
            if done.get(stage) is None and all(done.get(name) for name in before) and self._enqueue(mesh_id, stage) is _JobState.GAVE_UP:
                self._give_up(mesh_id, stage)
                return

    def _finish(self, mesh_id: str) -> None:
        with contextlib.suppress(CancelledError), records.publishing(self.store, mesh_id):
            done = {stage: records.read_stage(self.store, mesh_id, stage) for stage in STAGES}
            manifest = build_manifest(mesh_id, done)
            if records.write_manifest(self.store, manifest):
                log.info("mesh is %s", manifest.status, extra={"mesh": mesh_id})
        self._drop_jobs(mesh_id, STAGES)
        self.progress.clear(mesh_id)
        self.progress.notify(mesh_id)
        self._advance_later(mesh_id)

    def _give_up(self, mesh_id: str, stage: str) -> None:
        self._record(mesh_id, failed_record(stage, 0.0, problem_of(BROKEN)))
        self.advance(mesh_id)

    def _record(self, mesh_id: str, record: StageRecord) -> None:
        """Write the record of a stage that was not run, unless it has one."""
        with contextlib.suppress(CancelledError), records.publishing(self.store, mesh_id):
            if records.read_stage(self.store, mesh_id, record.stage) is None:
                records.write_stage(self.store, mesh_id, record)

    def _enqueue(self, mesh_id: str, stage: str) -> _JobState:
        queue, job_id = self._queue_of(stage), f"{mesh_id}-{stage}"
        state = self._state(queue, job_id)
        if state in (_JobState.ALIVE, _JobState.GAVE_UP):
            return state
        if state is _JobState.OVER and not self._remove_over(queue, job_id):
            return _JobState.ALIVE
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
        return _JobState.ALIVE

    def _state(self, queue: StageQueue, job_id: str) -> _JobState:
        """One look, in one transaction: RQ moves a living job between the three places atomically."""
        with self.redis.pipeline(transaction=True) as pipe:
            pipe.hget(Job.key_for(job_id), "status")
            pipe.lpos(queue.key, job_id)
            pipe.lpos(queue.intermediate_queue_key, job_id)
            pipe.zrange(_started(queue).key, 0, -1)
            status, waiting, taken, running = pipe.execute()
        if status is None:
            return _JobState.ABSENT
        if status.decode() == JobStatus.FAILED:
            return _JobState.GAVE_UP
        is_running = any(entry.decode().partition(":")[0] == job_id for entry in running)
        return _JobState.ALIVE if waiting is not None or taken is not None or is_running else _JobState.OVER

    def _remove_over(self, queue: StageQueue, job_id: str) -> bool:
        """Remove a job that is over, unless someone else has just changed it."""
        key = Job.key_for(job_id)
        with self.redis.pipeline(transaction=True) as pipe:
            pipe.watch(key)
            if self._state(queue, job_id) is not _JobState.OVER:
                return False
            pipe.multi()
            pipe.delete(key)
            try:
                pipe.execute()
            except redis.WatchError:
                return False
        return True

    def _drop_jobs(self, mesh_id: str, stages: Collection[str]) -> None:
        """Remove the jobs of a mesh that no worker has started, and of all what RQ notes of those on their way to one."""
        running = {entry.partition(":")[0] for queue in self._queues for entry in _started_entries(queue)}
        for stage in stages:
            queue, job_id = self._queue_of(stage), f"{mesh_id}-{stage}"
            if job_id not in running:
                self._delete_job(queue, job_id)
            self.redis.delete(IntermediateQueue(queue.key, self.redis).get_first_seen_key(job_id))

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


def _started(queue: StageQueue) -> StartedJobRegistry:
    return StartedJobRegistry(queue=queue)


def _started_entries(queue: StageQueue) -> list[str]:
    entries = cast(list[bytes], queue.connection.zrange(_started(queue).key, 0, -1))
    return [entry.decode() for entry in entries]


def _ended(done: dict[str, StageRecord | None]) -> bool:
    return all(done.values()) or any(record is not None and record.outcome == "failed" for record in done.values())
