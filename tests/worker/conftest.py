import pytest

from backend.local_store import LocalStore
from backend.queue import JobQueue
from backend.redis_connection import connect
from service.embedded import EmbeddedBackend
from worker.warm import warm_kernels


@pytest.fixture(scope="session")
def server(tmp_path_factory):
    """A private queue server without workers."""
    backend = EmbeddedBackend(tmp_path_factory.mktemp("server"), 0)
    backend.start()
    yield backend
    backend.stop()


@pytest.fixture
def queue(server, tmp_path):
    """An empty queue over a store of its own in `tmp_path`: nobody but the test works on it."""
    queue = JobQueue(connect(server.redis_url), LocalStore(tmp_path / "store"))
    queue.redis.flushall()
    yield queue
    queue.redis.close()


@pytest.fixture(scope="session")
def compiled():
    """Kernels that forked workers then have from this process: compiling them is not what tests of them wait for."""
    warm_kernels()
