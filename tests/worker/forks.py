"""A private queue, and workers that are forks of the tests' own process: so they have its kernels and its measurement."""

import os
import signal
import time
from contextlib import ExitStack, contextmanager
from pathlib import Path

from backend.queue import JobQueue
from backend.settings import BackendSettings
from backend.temporary_files import LOCK_FILES, lock_name
from schemas import jobs as names
from schemas import keys
from service.embedded import EmbeddedBackend
from worker.process import StageWorker, die_with_parent
from worker.settings import WorkerSettings


@contextmanager
def private_server(folder, patch, **settings):
    """A private server without workers; `patch` sets the environment of those that are forked, and what they measure by."""
    backend = EmbeddedBackend(folder, 0)
    backend.start()
    chosen = {"DATA_DIR": folder, "REDIS_URL": backend.redis_url, "MEASURE": "true", "RECONCILE_INTERVAL_S": "0.5"} | settings
    for name, value in chosen.items():
        patch.setenv(f"SILHOUETTE_{name}", str(value))
    patch.setattr(names, "MEASURE", "tests.worker.measuring.measure_mesh")
    try:
        yield backend
    finally:
        backend.stop()


@contextmanager
def private_queue(folder, patch, **settings):
    """The queue of such a server."""
    with private_server(folder, patch, **settings):
        yield JobQueue.open(BackendSettings())


def work():
    """Be a worker."""
    settings = WorkerSettings()
    StageWorker(JobQueue.open(settings), settings).work(logging_level="ERROR")


def keep_working():
    """Have a worker, and another whenever it ends."""
    while True:
        pid = os.fork()
        if pid == 0:
            try:
                die_with_parent()
                work()
            finally:
                os._exit(0)
        os.waitpid(pid, 0)
        time.sleep(0.1)


@contextmanager
def forked_workers(be=work):
    """A callable that starts so many workers, by what they do; their process ids. Those that are left at the end are killed."""
    pids = []

    def start(count):
        for _ in range(count):
            pid = os.fork()
            if pid == 0:
                try:
                    be()
                finally:
                    os._exit(0)
            pids.append(pid)
        return pids[-count:]

    try:
        yield start
    finally:
        for pid in pids:
            os.kill(pid, signal.SIGKILL)  # one that is dead already stays until it is waited for
            os.waitpid(pid, 0)


@contextmanager
def held_elsewhere(store, mesh_ids):
    """Hold meshes in a process of its own inside the block: a lock that this one held would go into every fork of it."""
    told, telling = os.pipe()
    pid = os.fork()
    if pid == 0:
        with ExitStack() as held:
            for key in {lock_name(keys.accepted(mesh_id), LOCK_FILES): keys.accepted(mesh_id) for mesh_id in mesh_ids}.values():
                held.enter_context(store.locked(key))
            os.write(telling, b"held")
            signal.pause()
    assert os.read(told, 4) == b"held"
    try:
        yield
    finally:
        os.kill(pid, signal.SIGKILL)
        os.waitpid(pid, 0)
        os.close(told)
        os.close(telling)


def descendants_of(pid):
    """Ids of the processes that a process has started, and of those that they have."""
    try:
        children = [int(word) for task in Path(f"/proc/{pid}/task").iterdir() for word in (task / "children").read_text().split()]
    except OSError:
        return []
    return [one for child in children for one in (child, *descendants_of(child))]


def lives(pid):
    """Whether there is such a process that has not ended; an init may be slow to reap."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except (FileNotFoundError, ProcessLookupError):
        return False
