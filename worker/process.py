"""The worker process: takes one job at a time off the queue and runs it in a fork of itself.

The process itself never asks the object store, but by children: what a store on other machines needs of a process does not come
along into a fork (`backend.s3_client`), and each job is one.

The times below make a killed worker's job run again after about 16 s (RQ's own: after minutes).
"""

from __future__ import annotations

import contextlib
import ctypes
import logging
import os
import signal
import threading
from collections.abc import Callable, Iterator
from functools import partial
from types import FrameType
from typing import Any

import redis
from rq import Worker
from rq.executions import Execution
from rq.job import Job, JobStatus
from rq.queue import Queue
from rq.serializers import JSONSerializer

from backend.logs import bound
from backend.queue import JobQueue
from backend.stage_jobs import StageQueue
from backend.tracing import REQUEST, open_tracing
from backend.turns import Turn
from schemas.errors import SilhouetteError
from schemas.jobs import LATER_QUEUE, ONCE_QUEUE
from worker.priority import give_way
from worker.settings import WorkerSettings

log = logging.getLogger("silhouette.worker")

WORKER_TTL_S = 17  # RQ waits 15 s less for a job before it looks after abandoned ones
MONITORING_S = 2
MAINTENANCE_S = 2
HEARTBEAT_TTL_S = 10  # RQ adds a minute to the rest of the job's time instead
RECONNECT_S = 2.0
PR_SET_PDEATHSIG = 1
LOWEST_PRIORITY = 19


class StageWorker(Worker):
    """A worker of both queues of stages; when idle it also compares the store with them. reader: of meshes that are not kept instead.

    asides: what it does beside.
    """

    queue_class = StageQueue
    max_connection_wait_time = RECONNECT_S

    def __init__(self, jobs: JobQueue, settings: WorkerSettings, *, reader: bool = False) -> None:
        self._jobs = jobs
        self._settings = settings
        self._returns_job = False
        self.asides = Asides()
        super().__init__(
            [jobs.once] if reader else [jobs.queue, jobs.later],
            connection=jobs.redis,
            serializer=JSONSerializer,
            worker_ttl=WORKER_TTL_S,
            job_monitoring_interval=MONITORING_S,
            maintenance_interval=MAINTENANCE_S,
        )

    def get_heartbeat_ttl(self, job: Job, working_time: float = 0.0) -> int:
        """Seconds after which a job without a sign of life counts as abandoned."""
        return HEARTBEAT_TTL_S

    def run_maintenance_tasks(self) -> None:
        """RQ's own, then what it is this worker's turn to do with the store, unless it still does something."""
        super().run_maintenance_tasks()
        if self.asides.busy():
            return
        if (turn := self._jobs.turn_to_reconcile()) is not None:
            self.asides.start(partial(in_turn, turn, self._settings.reconcile_interval_s, self._jobs.reconcile))
        elif (turn := self._jobs.turn_to_audit()) is not None:
            audit = partial(self._jobs.audit, self._settings.temporary_age_s)
            self.asides.start(partial(in_turn, turn, self._settings.audit_interval_s, audit))

    def maintain_heartbeats(self, job: Job, execution: Execution) -> None:
        """RQ's own, which makes the record of an execution again, for some seconds, when its job has just ended."""
        super().maintain_heartbeats(job, execution)
        if self.connection.zscore(job.started_job_registry.key, execution.composite_key) is None:
            self.connection.delete(execution.key)

    def main_work_horse(self, job: Job, queue: Queue) -> None:
        """The forked child, which dies with its worker: else a job that is started again would run twice at once.

        A later stage gets what processor time is left.
        """
        die_with_parent()
        give_way(LOWEST_PRIORITY if queue.name == LATER_QUEUE else self._settings.nice, os.getppid())
        super().main_work_horse(job, queue)

    def perform_job(self, job: Job, queue: Queue, execution: Execution) -> bool:
        """RQ's own; log lines and traces say which request the job comes from."""
        with seen_from_outside(job, self._settings):
            return bool(super().perform_job(job, queue, execution))

    def handle_warm_shutdown_request(self) -> None:
        """Told to stop: a job that runs may end within `stop_grace_s`; then it is stopped, and goes back to the queue."""
        super().handle_warm_shutdown_request()
        patience = threading.Timer(self._settings.stop_grace_s, self._stop_job)
        patience.daemon = True
        patience.start()

    def request_force_stop(self, signum: int, frame: FrameType | None) -> None:
        """Told again: the job is stopped now. RQ's own ends the worker, too, and leaves the job to be missed."""
        self._stop_job()

    def _stop_job(self) -> None:
        if self.horse_pid:
            self._returns_job = True
            self.kill_horse()

    def _return_job(self, job: Job, queue: Queue, execution: Execution | None) -> None:
        """Put a job that was stopped on purpose in front of its queue, at once and with no attempt less."""
        with self.connection.pipeline() as pipe:
            self.cleanup_execution(job, pipeline=pipe, execution=execution)
            job.set_status(JobStatus.QUEUED, pipeline=pipe)
            queue.push_job_id(job.id, pipeline=pipe, at_front=True)
            pipe.execute()
        log.info("returned a job that had not ended", extra={"job": job.id})

    def prepare_job_execution(self, job: Job, remove_from_intermediate_queue: bool = True) -> None:
        """RQ's own, but the job leaves the intermediate list of its queue, as if there were only one queue (`StageQueue.lpop`)."""
        super().prepare_job_execution(job, remove_from_intermediate_queue=True)

    def handle_job_failure(
        self, job: Job, queue: Queue, started_job_registry: Any = None, exc_string: str = "", execution: Execution | None = None
    ) -> None:
        """RQ's own; after the last attempt the mesh is told at once. A job that this worker stopped to end itself has not failed."""
        if self._returns_job:
            self._return_job(job, queue, execution)
            return
        super().handle_job_failure(job, queue, started_job_registry, exc_string, execution)
        if queue.name == ONCE_QUEUE:  # whoever waits stops waiting
            return
        with contextlib.suppress(redis.RedisError, SilhouetteError):  # the reconciler will do it
            if job.get_status() != JobStatus.FAILED:
                return
            if self.is_horse:
                self._jobs.advance(job.args[0])
            else:
                self.asides.start(partial(self._jobs.advance, job.args[0]))


class Asides:
    """Children that do something beside their parent's work, and end with it."""

    def __init__(self) -> None:
        self._running: list[int] = []

    def start(self, call: Callable[[], object]) -> None:
        """Call this in a child. What it raises is logged."""
        child = os.fork()
        if child:
            self._running.append(child)
            return
        try:
            for number in (signal.SIGINT, signal.SIGTERM):
                signal.signal(number, signal.SIG_DFL)
            die_with_parent()
            call()
        except (redis.RedisError, SilhouetteError, OSError) as error:
            log.warning("left to the next time: %s", error)
        except BaseException:
            log.exception("a child did not do its work")
        finally:
            os._exit(0)

    def busy(self) -> bool:
        """Whether one of them still runs."""
        self._running = [child for child in self._running if not os.waitpid(child, os.WNOHANG)[0]]
        return bool(self._running)


def in_turn(turn: Turn, pause_s: float, call: Callable[[], object]) -> None:
    """Call this in a turn that was taken, which nobody has again for `pause_s` seconds after it."""
    with turn.held(pause_s):
        call()


@contextlib.contextmanager
def seen_from_outside(job: Job, settings: WorkerSettings) -> Iterator[None]:
    """Inside the block log lines have the job's request and what it is about, and a trace goes on. For a process with one job."""
    carried = {name: str(value) for name, value in (job.meta or {}).items()}
    about = dict(zip(("mesh", "stage"), job.args, strict=False)) if job.origin != ONCE_QUEUE else {"token": job.args[0]}
    told = about | {name: carried[name] for name in (REQUEST,) if name in carried}
    with bound(**told), contextlib.ExitStack() as held:
        if (tracing := open_tracing("worker", settings.trace_endpoint)) is not None:
            held.callback(tracing.close)
            held.enter_context(tracing.root(about.get("stage", "read"), carried, **told))
        yield


def die_with_parent() -> None:
    """Ask the kernel to kill this process when the thread that made it ends."""
    parent = os.getppid()
    if ctypes.CDLL(None, use_errno=True).prctl(PR_SET_PDEATHSIG, signal.SIGKILL, 0, 0, 0) != 0:
        raise OSError(ctypes.get_errno(), "prctl")
    if os.getppid() != parent:
        os._exit(1)
