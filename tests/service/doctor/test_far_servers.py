"""The doctor tells apart what can be wrong with an S3 store and with a Redis behind TLS."""

import os

import pytest

from service.doctor import backend
from service.settings import ServiceSettings
from tests.disks import mounted
from tests.s3_server import BUCKET, CREDENTIALS, S3Server

ENFORCED = {"INITIAL_NO_AUTH_ACTION_COUNT": "0"}
"""For moto: every request needs credentials that it knows, and it knows none."""


def in_bucket(tmp_path, server, bucket=BUCKET):
    return ServiceSettings(data_dir=tmp_path / "data", store_url=f"s3://{bucket}/of/doctor", store_endpoint=server.endpoint)


@pytest.fixture
def credentials(monkeypatch):
    for name, value in CREDENTIALS.items():
        monkeypatch.setenv(name, value)


def test_an_s3_store_that_works_is_found_sound(tmp_path, s3_server, credentials):
    found = backend.check_store(in_bucket(tmp_path, s3_server))
    assert found.state == "ok" and f"s3://{BUCKET}/of/doctor" in found.found


def test_a_bucket_that_is_missing_is_to_be_made(tmp_path, s3_server, credentials):
    found = backend.check_store(in_bucket(tmp_path, s3_server, "no-such-bucket"))
    assert found.state == "failed" and "make that bucket" in found.fix


def test_wrong_keys_of_a_store_are_named_and_not_said(tmp_path, credentials):
    with S3Server(ENFORCED) as server:
        found = backend.check_store(in_bucket(tmp_path, server))
    assert found.state == "failed" and "AWS_SECRET_ACCESS_KEY" in found.fix
    assert CREDENTIALS["AWS_SECRET_ACCESS_KEY"] not in found.found + found.fix


def test_a_store_that_does_not_answer_is_to_be_started(tmp_path, s3_server, credentials):
    found = backend.check_store(in_bucket(tmp_path, s3_server).model_copy(update={"store_endpoint": "http://127.0.0.1:1"}))
    assert found.state == "failed" and "SILHOUETTE_STORE_ENDPOINT" in found.fix


def test_a_disk_without_room_is_to_be_given_some(tmp_path):
    with mounted(tmp_path / "small", 1) as disk:
        (disk / "filler").write_bytes(os.urandom(900_000))
        found = backend.check_store(ServiceSettings(data_dir=disk))
    assert found.state == "failed" and "make room" in found.fix


@pytest.fixture
def relay(tmp_path, redis_url):
    """The port of a relay that speaks TLS before a Redis, and the authority that signed its certificate."""
    tls = pytest.importorskip("tests.tls", reason="the package cryptography is not installed")
    authority, certificate = tls.make_authority(tmp_path, "127.0.0.1")
    with tls.TlsRelay(certificate, redis_url.removeprefix("unix://")) as port:
        yield port, authority


def test_a_redis_behind_tls_whose_authority_is_named_is_found_sound(tmp_path, relay):
    port, authority = relay
    given = {"redis_url": f"rediss://127.0.0.1:{port}/0", "redis_ca_file": authority}
    assert backend.check_queue(ServiceSettings(data_dir=tmp_path, **given)).state == "ok"


def test_an_authority_that_nobody_knows_is_to_be_named(tmp_path, relay):
    found = backend.check_queue(ServiceSettings(data_dir=tmp_path, redis_url=f"rediss://127.0.0.1:{relay[0]}/0"))
    assert found.state == "failed" and "certificate" in found.found.lower() and "SILHOUETTE_REDIS_CA_FILE" in found.fix


def test_a_server_that_wants_tls_is_said_to(tmp_path, relay):
    found = backend.check_queue(ServiceSettings(data_dir=tmp_path, redis_url=f"redis://127.0.0.1:{relay[0]}/0"))
    assert found.state == "failed" and "rediss://" in found.fix
