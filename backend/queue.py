"""The job queue: RQ on Redis, filled from the store.

The store says what is to be done: a stage is due when the stages before it have a record and it has none, and what has stages to go
is marked there (`backend.unfinished`). Redis only carries that to the workers (`backend.stage_jobs`), so any loss of it is made good by
`reconcile`. Enqueueing twice is nothing; running twice writes the same bytes.
"""

from __future__ import annotations

import contextlib
import logging
import math
from collections.abc import Mapping
from typing import Any

import redis
from rq.serializers import JSONSerializer

from backend import once, records, unfinished
from backend.audit import audit
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
from backend.turns import Turn
from schemas import keys
from schemas.errors import CancelledError, DamagedArtifactError, SilhouetteError, StorageFullError
from schemas.jobs import LATER_STAGES, ONCE_QUEUE, READ_MESH, STAGES
from schemas.manifest import StageRecord

log = logging.getLogger(__name__)

RECONCILE_TURN = "silhouette:reconciling"
AUDIT_TURN = "silhouette:auditing"
MEASURED_AUDIT_TURN = "silhouette:auditing-measured"
"""Of processes with `measure`: where that is turned on, meshes that were at their end are found at once."""


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

    def advance(self, mesh_id: str) -> bool:
        """Bring a mesh forward from what the store says: enqueue the stages that are due, or end it with its manifest.

        A mesh that is ready goes on with the later stages where `measure` is on. Whether there was anything to wait for: not for a mesh
        that is deleted, failed or at its end, whose mark is taken away.
        Raises redis.RedisError, StorageFullError, DamagedArtifactError.
        """
        if not records.is_accepted(self.store, mesh_id):
            return False
        if not self.store.exists(keys.manifest(mesh_id)):
            done = {stage: records.read_stage(self.store, mesh_id, stage) for stage in STAGES}
            if not _ended(done):
                self._enqueue_due(mesh_id, STAGES, done)
                return True
            self._finish(mesh_id)
        if self.measure and self._advance_later(mesh_id):
            return True
        records.settle(self.store, mesh_id, LATER_STAGES if self.measure else ())
        return False

    def reconcile(self) -> int:
        """Advance every marked mesh; how many have stages to go. What was left without an acceptance is removed.

        Run at start and every few seconds. Raises redis.RedisError.
        """
        count = 0
        for mesh_id, age_s in unfinished.marked(self.store):
            try:
                if self._advance_or_rebuild(mesh_id):
                    count += 1
                elif age_s > unfinished.ABANDONED_S and not records.is_accepted(self.store, mesh_id):
                    records.remove_abandoned(self.store, mesh_id)
            except SilhouetteError:  # one mesh must not keep the others waiting
                log.exception("mesh cannot be advanced", extra={"mesh": mesh_id})
        return count

    def audit(self, temporary_age_s: float) -> None:
        """Go through everything in the store, for what no mark says (`backend.audit`), meshes that are not kept among it."""
        audit(self.store, measure=self.measure)
        once.sweep(once.store_of(self.store), temporary_age_s)

    def reconcile_in_turn(self, interval_s: float) -> None:
        """`reconcile`, unless some process does so or has done so within the last `interval_s`. Raises redis.RedisError."""
        if (turn := self.turn_to_reconcile()) is not None:
            with turn.held(interval_s):
                self.reconcile()

    def audit_in_turn(self, interval_s: float, temporary_age_s: float) -> None:
        """`audit`, likewise."""
        if (turn := self.turn_to_audit()) is not None:
            with turn.held(interval_s):
                self.audit(temporary_age_s)

    def turn_to_reconcile(self) -> Turn | None:
        """The turn to `reconcile`, unless another process has it. Raises redis.RedisError."""
        return Turn.take(self.redis, RECONCILE_TURN)

    def turn_to_audit(self) -> Turn | None:
        """The turn to `audit`, likewise."""
        return Turn.take(self.redis, MEASURED_AUDIT_TURN if self.measure else AUDIT_TURN)

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
        """Run the stages of a mesh again whose files are damaged; their names. Nothing of a mesh that is deleted or sound, nor while
        the store is full: whoever reads them next finds them again."""
        dropped: list[str] = []
        try:
            with contextlib.suppress(CancelledError):
                dropped = drop_damaged(self.store, mesh_id)
        except StorageFullError:
            log.exception("damaged files stay", extra={"mesh": mesh_id})
            return []
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

    def _advance_or_rebuild(self, mesh_id: str) -> bool:
        try:
            return self.advance(mesh_id)
        except DamagedArtifactError:
            self.rebuild(mesh_id)
            return True

    def _advance_later(self, mesh_id: str) -> bool:
        """Enqueue the later stages of a ready mesh that are due; whether some have not ended. What needs one that failed is skipped."""
        manifest = records.read_manifest(self.store, mesh_id)
        if manifest is None or manifest.status != "ready":
            return False
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
            return False
        return True

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
