"""The preprocessing: which function does which stage, and what becomes of its result.

    load -> hull -> bake ---> verify
                 -> levels -/
         -> tree ----------/
         -> inner --------/

and, where `measure` is on, of a mesh that is ready, when nothing else is to be done:

    hulls -> measure

Their order is `schemas.jobs.STAGES` and `LATER_STAGES`. A stage reads its inputs from the store, calls one pure function and hands
back what to keep (`worker.stages`). Here that is published, all of it or nothing, with the stage's record last; then the queue looks
what is due next.
"""

from __future__ import annotations

import logging
import resource
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rq.timeouts import JobTimeoutException

from backend import records
from backend.artifacts import identity_of, write_artifact
from backend.counts import count_end, count_start
from backend.manifests import failed_record
from backend.pace import Paced
from backend.problems import problem_of
from backend.queue import JobQueue
from backend.store import Store
from schemas import keys
from schemas.errors import (
    CancelledError,
    DamagedArtifactError,
    SilhouetteError,
    StageFailedError,
    StorageFullError,
    StoreUnavailableError,
)
from schemas.jobs import LATER_STAGES
from schemas.manifest import StageRecord
from worker import stages
from worker.settings import WorkerSettings
from worker.stages import Inputs, Result

log = logging.getLogger("silhouette.jobs")

STAGE_FUNCTIONS: dict[str, Callable[[Inputs], Result | None]] = {
    "load": stages.load,
    "hull": stages.hull,
    "bake": stages.bake,
    "levels": stages.levels,
    "tree": stages.tree,
    "inner": stages.inner,
    "verify": stages.verify,
    "hulls": stages.hulls,
    "measure": stages.measure,
}

KIB_PER_MIB = 1024


def run_stage(mesh_id: str, stage: str) -> None:
    """Run one stage of a mesh and bring the mesh forward: what the queue calls, in a process of its own.

    A fault of the mesh ends the mesh, or a later stage; any other exception goes to the queue, which tries again.
    """
    jobs = JobQueue.open(WorkerSettings())
    if stage in LATER_STAGES and not jobs.measure:  # enqueued before that was turned off
        return
    try:
        report(jobs, mesh_id, stage, 0.0)
        if records.read_stage(jobs.store, mesh_id, stage) is None:
            count_start(jobs.redis, stage)
            if (record := run_and_record(jobs, mesh_id, stage)) is None:
                return  # the reconciler starts it again
            count_end(jobs.redis, record)
        report(jobs, mesh_id, stage, 1.0)
        jobs.advance(mesh_id)
    except CancelledError:
        log.info("stopped: the mesh is gone", extra={"mesh": mesh_id, "stage": stage})
        jobs.progress.clear(mesh_id)
    except DamagedArtifactError:
        log.exception("an input is damaged", extra={"mesh": mesh_id, "stage": stage})
        jobs.rebuild(mesh_id)
    except (StorageFullError, StoreUnavailableError):  # the reconciler starts the stage again, until it can be stored
        log.exception("not stored", extra={"mesh": mesh_id, "stage": stage})


def run_and_record(jobs: JobQueue, mesh_id: str, stage: str) -> StageRecord | None:
    """Run one stage and publish its result with its record; None when it paused, and is to be started again.

    Raises CancelledError, StorageFullError, StoreUnavailableError, DamagedArtifactError, and what is nobody's fault.
    """
    started = time.perf_counter()
    look = Paced(lambda: check_wanted(jobs.store, mesh_id, stage), jobs.store.look_interval_s)
    inputs = Inputs(jobs.store, mesh_id, lambda fraction: report(jobs, mesh_id, stage, fraction, look), jobs.has_waiting)
    try:
        inputs.progress(0.0)
        result = STAGE_FUNCTIONS[stage](inputs)
        if result is None:
            log.info("stage paused", extra={"mesh": mesh_id, "stage": stage})
            return None
        with publishing(jobs.store, mesh_id, stage):
            record = StageRecord(
                stage=stage,
                outcome="skipped" if result.skipped else "done",
                artifacts=publish(jobs.store, mesh_id, stage, result),
                report=result.report,
                seconds=time.perf_counter() - started,
                peak_mib=peak_mib(),
            )
            records.write_stage(jobs.store, mesh_id, record)
    except (CancelledError, StorageFullError, StoreUnavailableError, DamagedArtifactError):
        raise
    except (SilhouetteError, MemoryError, JobTimeoutException) as error:
        record = failed_record(stage, time.perf_counter() - started, problem_of(fault_of(error)))
        log.warning("stage failed: %s", error, extra={"mesh": mesh_id, "stage": stage}, exc_info=True)
        with publishing(jobs.store, mesh_id, stage):
            records.write_stage(jobs.store, mesh_id, record)
    log.info("stage %s", record.outcome, extra={"mesh": mesh_id, "stage": stage, "seconds": round(record.seconds, 3)})
    return record


def publish(store: Store, mesh_id: str, stage: str, result: Result) -> dict[str, str]:
    """Write a stage's artifacts and downloads; file name -> sha256 of the contents."""
    digests = {}
    for layout, tensors in result.artifacts:
        digests[layout.file] = write_artifact(store, mesh_id, layout, tensors, identity_of(mesh_id, stage))
    for name, data in result.downloads.items():
        store.put_bytes(keys.artifact(mesh_id, name), data)
        digests[name] = stages.sha256(data)
    return digests


def report(jobs: JobQueue, mesh_id: str, stage: str, fraction: float, look: Callable[[], None] | None = None) -> None:
    """Pass progress on, then look whether the stage is wanted, by `look` or at once.

    Raises CancelledError when it is not: what was passed on is then to be cleared.

    It is passed on first: a mesh that is deleted after the look is cleared by whoever deletes it, one before by the caller.
    """
    jobs.progress.report(mesh_id, stage, fraction)
    if look is not None:
        look()
    else:
        check_wanted(jobs.store, mesh_id, stage)


def check_wanted(store: Store, mesh_id: str, stage: str) -> None:
    """Raise CancelledError when the mesh is deleted, or has ended, or, for a later stage, has not: it was accepted anew meanwhile."""
    if not records.is_accepted(store, mesh_id) or store.exists(keys.manifest(mesh_id)) != (stage in LATER_STAGES):
        raise CancelledError("the mesh has been deleted or has ended", mesh=mesh_id)


@contextmanager
def publishing(store: Store, mesh_id: str, stage: str) -> Iterator[None]:
    """Hold the mesh while the result of a stage is written. Raises CancelledError when it is no longer wanted."""
    with records.publishing(store, mesh_id):
        check_wanted(store, mesh_id, stage)
        yield


def fault_of(error: Exception) -> SilhouetteError:
    """What a mesh is told about an error that running again will not change."""
    if isinstance(error, SilhouetteError):
        return error
    if isinstance(error, MemoryError):
        return StageFailedError("The mesh needs more memory than a worker has.", code="out-of-memory")
    return StageFailedError("The stage took longer than it may.", code="time-limit")


def peak_mib() -> float:
    """Most memory that this process, or a child it has waited for, has had resident so far, MiB."""
    with open("/proc/self/status") as status:  # noqa: PTH123
        own_kib = next(int(line.split()[1]) for line in status if line.startswith("VmHWM:"))
    return round(max(own_kib, resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss) / KIB_PER_MIB, 1)
