"""The job queue: RQ on Redis, filled from the store.

The store says what is to be done: a stage is due when the stages before it have a record and it has none. Redis only carries
that to the workers (`backend.stage_jobs`), so any loss of it is made good by `reconcile`. Enqueueing twice is nothing; running twice
writes the same bytes.
"""

from __future__ import annotations

import contextlib
import logging
import math
from collections.abc import Collection, Iterator, Mapping
from typing import Any

import redis
from rq.serializers import JSONSerializer

from backend import records
from backend.damage import drop_damaged
from backend.manifests import build_manifest, failed_record
from backend.problems import BROKEN, problem_of
from backend.progress import Progress
from backend.redis_connection import connect
from backend.settings import BackendSettings
from backend.stage_jobs import RESULT_S, JobState, StageJobs, StageQueue
from backend.store import Store
from backend.stores import open_store
from backend.tracing import carried
from schemas import keys
from schemas.errors import CancelledError, DamagedArtifactError, SilhouetteError
from schemas.jobs import LATER_STAGES, ONCE_QUEUE, READ_MESH, STAGES
from schemas.manifest import StageRecord

log = logging.getLogger(__name__)

RECONCILE_LOCK = "silhouette:reconciling"


class JobQueue:
    """All meshes on their way. `jobs` are those of their stages; `attempts` is how often one is started when it breaks or its worker dies.

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
        self.jobs = StageJobs(connection, stage_timeout_s=stage_timeout_s, attempts=attempts, job_record_s=job_record_s)
        self.queue, self.later = self.jobs.queue, self.jobs.later
        self.once = StageQueue(ONCE_QUEUE, connection=connection, serializer=JSONSerializer)
        self._settled: dict[str, str] = {}

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
                self._advance_or_rebuild(mesh_id)
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
            self.jobs.drop(mesh_id, (*STAGES, *LATER_STAGES))
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

    def _advance_or_rebuild(self, mesh_id: str) -> None:
        try:
            self.advance(mesh_id)
        except DamagedArtifactError:
            self.rebuild(mesh_id)

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
            if done.get(stage) is None and all(done.get(name) for name in before) and self.jobs.enqueue(mesh_id, stage) is JobState.GAVE_UP:
                self._give_up(mesh_id, stage)
                return

    def _finish(self, mesh_id: str) -> None:
        with contextlib.suppress(CancelledError), records.publishing(self.store, mesh_id):
            done = {stage: records.read_stage(self.store, mesh_id, stage) for stage in STAGES}
            manifest = build_manifest(mesh_id, done)
            if records.write_manifest(self.store, manifest):
                log.info("mesh is %s", manifest.status, extra={"mesh": mesh_id})
        self.jobs.drop(mesh_id, STAGES)
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


def _ended(done: dict[str, StageRecord | None]) -> bool:
    return all(done.values()) or any(record is not None and record.outcome == "failed" for record in done.values())
