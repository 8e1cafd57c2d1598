"""Reads a mesh that is not kept, for a client that waits: the stage load, in the same limited child, and nothing after it."""

from __future__ import annotations

import logging
import time
from collections.abc import Mapping
from typing import Any

from rq.timeouts import JobTimeoutException

from backend import once, records
from backend.manifests import failed_record
from backend.pace import Paced
from backend.problems import problem_of
from backend.queue import JobQueue
from backend.store import Store
from schemas import keys
from schemas.errors import CancelledError, SilhouetteError, StoreUnavailableError
from schemas.manifest import StageRecord
from schemas.mesh import PreprocessOptions
from worker.jobs import fault_of, publish
from worker.load import load_mesh
from worker.settings import WorkerSettings
from worker.stages import loaded

log = logging.getLogger("silhouette.once")


def read_mesh(token: str, extension: str, options: Mapping[str, Any]) -> None:
    """What the queue calls, in a process of its own: leave the mesh, or what is wrong with it, under its token."""
    read(once.store_of(JobQueue.open(WorkerSettings()).store), token, extension, PreprocessOptions.model_validate(options))


def read(store: Store, token: str, extension: str, options: PreprocessOptions) -> None:
    """The same in a store of `backend.once`. Leaves nothing where nobody waits any more."""
    started = time.perf_counter()
    try:
        record = _loaded(store, token, extension, options, started)
    except CancelledError:
        log.info("stopped: nobody waits", extra={"token": token})
        return
    except StoreUnavailableError:  # nor can it be told so: whoever waits gives up
        raise
    except (SilhouetteError, MemoryError, JobTimeoutException) as error:
        log.warning("mesh not read: %s", error, extra={"token": token})
        record = failed_record(once.LOAD, time.perf_counter() - started, problem_of(fault_of(error)))
    records.write_stage(store, token, record)
    if not once.is_wanted(store, token):
        once.forget(store, token)


def _loaded(store: Store, token: str, extension: str, options: PreprocessOptions, started: float) -> StageRecord:
    def check_wanted() -> None:
        if not once.is_wanted(store, token):
            raise CancelledError("nobody waits for the mesh", token=token)

    check_wanted()
    look = Paced(check_wanted, store.look_interval_s)
    upload = store.local_path(keys.upload(token))
    result = loaded(load_mesh(upload, extension, options, progress=lambda _: look()))
    artifacts = publish(store, token, once.LOAD, result)
    return StageRecord(stage=once.LOAD, outcome="done", artifacts=artifacts, report=result.report, seconds=time.perf_counter() - started)
