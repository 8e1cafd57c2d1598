"""A queue behind a password and TLS. The server is a real one; what speaks TLS before it is a relay, since not every build of it can."""

import asyncio
import os
import subprocess
import sys
import time

import pytest
import redis

from backend.local_store import LocalStore
from backend.queue import JobQueue
from backend.redis_connection import connect, connection_options
from backend.settings import BackendSettings
from schemas.jobs import WORKER_MODULE
from service.access.quotas import RequestQuota
from service.embedded import find_server
from tests.backend.accepting import accept

tls = pytest.importorskip("tests.tls", reason="the package cryptography is not installed")
PASSWORD = "pass-word-of-tests"


@pytest.fixture(scope="module")
def guarded(tmp_path_factory):
    """The unix socket of a server that wants a password."""
    folder = tmp_path_factory.mktemp("guarded")
    path = folder / "v.sock"
    command = [find_server(), "--port", "0", "--unixsocket", path, "--dir", folder, "--save", "", "--requirepass", PASSWORD]
    process = subprocess.Popen([str(part) for part in command], stdout=subprocess.DEVNULL)
    deadline = time.monotonic() + 20.0
    while not path.exists() and time.monotonic() < deadline:
        time.sleep(0.02)
    yield path
    process.kill()
    process.wait()


@pytest.fixture(scope="module")
def certificates(tmp_path_factory):
    return tls.make_authority(tmp_path_factory.mktemp("certificates"), "127.0.0.1")


@pytest.fixture(scope="module")
def tls_port(guarded, certificates):
    with tls.TlsRelay(certificates[1], str(guarded)) as port:
        yield port


@pytest.fixture
def password_file(tmp_path):
    file = tmp_path / "password"
    file.write_text(f"{PASSWORD}\n")
    return file


def test_a_password_comes_in_the_url_or_from_a_file(guarded, password_file):
    assert connect(f"unix://:{PASSWORD}@{guarded}").ping()
    assert connect(f"unix://{guarded}", password_file).ping()


@pytest.mark.parametrize("given", ["", "unix://:wrong-word@"])
def test_a_wrong_password_is_refused_without_being_said(guarded, given):
    with pytest.raises(redis.AuthenticationError) as refusal:
        connect(f"{given or 'unix://'}{guarded}").ping()
    assert "wrong-word" not in str(refusal.value)


def test_a_queue_works_over_tls_with_a_password(tls_port, certificates, password_file, tmp_path):
    settings = BackendSettings(
        data_dir=tmp_path,
        redis_url=f"rediss://127.0.0.1:{tls_port}/0",
        redis_password_file=password_file,
        redis_ca_file=certificates[0],
    )
    queue = JobQueue.open(settings)
    mesh_id = accept(queue.store)
    queue.advance(mesh_id)
    assert queue.queue.get_job_ids() == [f"{mesh_id}-load"]
    assert queue.cancel(mesh_id) and queue.queue.get_job_ids() == []
    assert isinstance(queue.store, LocalStore)


def test_a_server_that_another_authority_vouches_for_is_refused(tls_port, tmp_path, password_file):
    other, _ = tls.make_authority(tmp_path, "127.0.0.1")
    for ca_file in (None, other):
        with pytest.raises(redis.ConnectionError, match=r"(?i)certificate"):
            connect(f"rediss://127.0.0.1:{tls_port}/0", password_file, ca_file).ping()


def test_a_server_of_another_name_is_refused(tls_port, certificates, password_file):
    with pytest.raises(redis.ConnectionError, match=r"(?i)hostname"):
        connect(f"rediss://localhost:{tls_port}/0", password_file, certificates[0]).ping()


def test_nothing_is_said_in_the_clear_to_a_server_that_wants_tls(tls_port, password_file):
    with pytest.raises(redis.ConnectionError):
        connect(f"redis://127.0.0.1:{tls_port}/0", password_file).ping()


def test_a_worker_with_a_wrong_password_ends_with_a_sentence_that_does_not_say_it(guarded, tmp_path):
    environment = {**os.environ, "SILHOUETTE_DATA_DIR": str(tmp_path), "SILHOUETTE_REDIS_URL": f"unix://:wrong-word@{guarded}"}
    ended = subprocess.run([sys.executable, "-m", WORKER_MODULE], env=environment, capture_output=True, text=True, timeout=120, check=False)
    assert ended.returncode == 1
    assert "refuses" in ended.stderr and "wrong-word" not in ended.stderr + ended.stdout


def test_quotas_are_counted_together_over_tls_with_a_password(tls_port, certificates, password_file):
    url = f"rediss://127.0.0.1:{tls_port}/0"

    async def left():
        quotas = [RequestQuota(url, connection_options(url, password_file, certificates[0])) for _ in range(2)]
        counted = [(await quota.count("a-key", 5)).left for quota in quotas]
        for quota in quotas:
            await quota.close()
        return counted

    assert asyncio.run(left()) == [4, 3]
