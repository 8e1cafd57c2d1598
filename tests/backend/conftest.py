import pytest

from backend.queue import JobQueue, connect
from backend.store import Store
from service.embedded import EmbeddedBackend
from tests.disks import mounted


@pytest.fixture(scope="session")
def redis_url(tmp_path_factory):
    """A real private server without workers."""
    backend = EmbeddedBackend(tmp_path_factory.mktemp("embedded"), worker_count=0)
    backend.start()
    yield backend.redis_url
    backend.stop()


@pytest.fixture
def connection(redis_url):
    connection = connect(redis_url)
    connection.flushall()
    yield connection
    connection.close()


@pytest.fixture
def store(tmp_path):
    return Store(tmp_path / "store")


@pytest.fixture
def queue(connection, store):
    return JobQueue(connection, store)


@pytest.fixture
def small_disk(tmp_path):
    """A file system of 1 MiB, to be filled for real."""
    with mounted(tmp_path / "small", 1) as mount:
        yield mount
