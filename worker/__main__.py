"""`python -m worker`: take preprocessing jobs off the queue until told to stop. `--reader`: those of meshes that are not kept."""

from __future__ import annotations

import fcntl
import logging
import os
import sys
import threading
import time
from pathlib import Path

import redis
from pydantic import ValidationError

from backend import once
from backend.logs import configure_logs
from backend.queue import JobQueue
from backend.settings import setting_faults
from backend.store import Store
from schemas.jobs import READER_FLAG
from worker.jobs import STAGE_FUNCTIONS
from worker.priority import give_way
from worker.process import StageWorker, die_with_parent
from worker.settings import WorkerSettings
from worker.warm import start_compiler, warm_kernels

log = logging.getLogger("silhouette.worker")

CONNECT_S = 30.0
FAILED, NOT_CONFIGURED = 1, 2


def main() -> int:
    """Run one worker; the exit status. Redis errors end it: whoever keeps it running starts it again."""
    try:
        settings = WorkerSettings()
    except ValidationError as error:
        print(*setting_faults(error), sep="\n", file=sys.stderr)
        return NOT_CONFIGURED
    configure_logs("worker", settings.log_level)
    if settings.redis_url is None:
        log.error("SILHOUETTE_REDIS_URL is not set: a worker needs the Redis that its service uses")
        return NOT_CONFIGURED
    settings.data_dir.mkdir(parents=True, exist_ok=True)
    log.info("stages: %s", ", ".join(STAGE_FUNCTIONS))
    give_way(settings.nice, os.getpid())
    jobs = JobQueue.open(settings)
    if not wait_for_redis(jobs.redis):
        log.error("the queue does not answer")
        return FAILED
    if settings.warm_kernels:
        warm_in_background(settings.data_dir)
    start_compiler()
    worker = StageWorker(jobs, settings, reader=READER_FLAG in sys.argv[1:])
    worker.asides.start(lambda: sweep(jobs.store, settings.temporary_age_s))
    worker.work()
    return 0


def sweep(store: Store, age_s: float) -> None:
    """Remove temporary files that interrupted calls left on this machine."""
    store.sweep_temporary(age_s)
    once.store_of(store).sweep_temporary(age_s)


def wait_for_redis(connection: redis.Redis) -> bool:
    """Whether the server answers in time; it may start together with this process."""
    deadline = time.monotonic() + CONNECT_S
    while time.monotonic() < deadline:
        try:
            connection.ping()
        except redis.AuthenticationError:
            log.error("the queue refuses this worker's password")  # noqa: TRY400
            return False
        except redis.RedisError:
            time.sleep(0.1)
        else:
            return True
    return False


def warm_in_background(data_dir: Path) -> None:
    """Compile the kernels in a child, so that this process starts no threads that a fork would lose. One worker does it."""
    child = os.fork()
    if child:
        threading.Thread(target=os.waitpid, args=(child, 0), name="warm", daemon=True).start()
        return
    status = FAILED
    try:
        die_with_parent()
        os.nice(10)
        with (data_dir / "warming").open("ab") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            warm_kernels()
        status = 0
    except BlockingIOError:
        status = 0
    except BaseException:
        log.exception("kernels not warmed")
    finally:
        os._exit(status)


if __name__ == "__main__":
    sys.exit(main())
