import uuid

import pytest

from backend.local_store import LocalStore
from backend.queue import JobQueue
from backend.redis_connection import connect
from backend.s3_client import S3Place
from backend.s3_store import S3Store
from service.embedded import EmbeddedBackend
from tests.disks import mounted
from tests.s3_server import BUCKET, CREDENTIALS, S3Server


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


@pytest.fixture(scope="session")
def s3_server():
    """A server that speaks S3."""
    pytest.importorskip("moto.server", reason="moto, flask or flask-cors is not installed")
    with S3Server() as server:
        yield server


@pytest.fixture
def s3_place(s3_server, monkeypatch):
    """A place of its own in the server's bucket."""
    for name, value in CREDENTIALS.items():
        monkeypatch.setenv(name, value)
    return S3Place(BUCKET, f"of/{uuid.uuid4().hex}", s3_server.endpoint)


@pytest.fixture
def s3_store(s3_place, tmp_path):
    return S3Store(s3_place, tmp_path / "cache", 64 << 20)


@pytest.fixture(params=["local", "s3"])
def store(request, tmp_path):
    """Every kind of store in turn."""
    return LocalStore(tmp_path / "store") if request.param == "local" else request.getfixturevalue("s3_store")


@pytest.fixture
def queue(connection, store):
    return JobQueue(connection, store)


@pytest.fixture
def small_disk(tmp_path):
    """A file system of 1 MiB, to be filled for real."""
    with mounted(tmp_path / "small", 1) as mount:
        yield mount
