"""What only a store on another machine can get wrong."""

import logging
import mmap
import multiprocessing
import os
import signal
import threading
import time
from dataclasses import replace
from functools import partial
from pathlib import Path

import pytest

from backend import leases, s3_client
from backend.s3_client import ChangedError, S3Client, S3Place
from backend.s3_store import LOCK_OBJECTS, S3Store
from backend.temporary_files import LOCK_FILES
from schemas.errors import CorruptArtifactError, NotFoundError, StorageFullError, StoreUnavailableError
from tests.backend.test_store import again, put_file, spawn
from tests.s3_server import BUCKET, CREDENTIALS, S3Server

MIB = 1 << 20


@pytest.fixture
def elsewhere(s3_place, tmp_path):
    """The same store, of another machine."""
    return S3Store(s3_place, tmp_path / "elsewhere", 64 * MIB)


def copies(store):
    return sorted((store._folder / "copies").iterdir())


def test_two_machines_see_the_same_objects(s3_store, elsewhere):
    put_file(s3_store, "uploads/a", b"mesh" * 1000)
    assert elsewhere.local_path("uploads/a").read_bytes() == b"mesh" * 1000
    elsewhere.put_bytes("uploads/a", b"other")
    assert s3_store.local_path("uploads/a").read_bytes() == b"other"
    assert elsewhere.delete("uploads/a")
    with pytest.raises(NotFoundError):
        s3_store.local_path("uploads/a")


def test_large_files_go_in_parts_and_come_back_whole(s3_store, elsewhere):
    data = os.urandom(2 * s3_client.PART_BYTES + 12345)
    put_file(s3_store, "uploads/large", data)
    assert elsewhere.local_path("uploads/large").read_bytes() == data
    assert elsewhere.version("uploads/large").strip('"').endswith("-3")


def test_a_copy_is_downloaded_once_for_many_threads_and_again_for_another_version(s3_store, elsewhere, monkeypatch):
    downloads = []
    download = S3Client.download

    def counted(client, key, tag):
        downloads.append(key)
        return download(client, key, tag)

    monkeypatch.setattr(S3Client, "download", counted)
    put_file(s3_store, "uploads/a", bytes(MIB))
    paths = []
    threads = [threading.Thread(target=lambda: paths.append(elsewhere.local_path("uploads/a"))) for _ in range(6)]
    [thread.start() for thread in threads]
    [thread.join() for thread in threads]
    assert len(set(paths)) == 1 and downloads == ["uploads/a"]
    s3_store.put_bytes("uploads/a", b"new")
    assert elsewhere.local_path("uploads/a").read_bytes() == b"new"
    assert len(downloads) == 2


def test_what_was_stored_here_is_not_downloaded(s3_store, monkeypatch):
    monkeypatch.setattr(S3Client, "download", None)
    put_file(s3_store, "uploads/a", b"mesh")
    assert s3_store.local_path("uploads/a").read_bytes() == b"mesh"


def test_an_object_that_was_changed_on_its_way_is_refused(s3_store, elsewhere):
    """Stored with the hash of other bytes, as if the store had lost some."""
    with s3_store.temporary() as file:
        file.write(b"what was sent")
        file.flush()
        s3_store._client.put_file("uploads/a", Path(file.name), "0" * 64)
    with pytest.raises(CorruptArtifactError):
        elsewhere.local_path("uploads/a")
    assert copies(elsewhere) == [] and elsewhere.sweep_temporary(-1.0) == 0


def aged(path, seconds=1000.0):
    os.utime(path, (time.time() - seconds, time.time() - seconds))


def test_copies_used_longest_ago_go_first_and_fresh_ones_stay(s3_place, s3_store, tmp_path):
    small = S3Store(s3_place, tmp_path / "small", 3 * MIB)
    paths = []
    for number in range(3):
        put_file(s3_store, f"uploads/{number}", bytes([number]) * MIB)
        paths.append(small.local_path(f"uploads/{number}"))
        aged(paths[-1], 3000 - 1000 * number)
    assert small.local_path("uploads/0") == paths[0]  # and so it was used last
    put_file(s3_store, "uploads/3", bytes(MIB))
    newest = small.local_path("uploads/3")
    assert copies(small) == sorted([paths[0], paths[2], newest])
    put_file(s3_store, "uploads/4", bytes(3 * MIB))
    small.local_path("uploads/4")
    assert paths[0].exists() and newest.exists()  # over the limit, for they may not be mapped yet


def test_a_mapped_copy_that_goes_stays_readable(s3_store, elsewhere):
    put_file(s3_store, "uploads/a", b"m" * MIB)
    path = elsewhere.local_path("uploads/a")
    with path.open("rb") as file:
        mapped = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
    aged(path)
    assert elsewhere._cache.evict(0) == MIB
    assert not path.exists()
    assert mapped[:] == b"m" * MIB
    assert elsewhere.local_path("uploads/a").read_bytes() == b"m" * MIB


def _upload(store, source):
    store().put_file("uploads/torn", source)


@pytest.mark.parametrize("after_s", [0.05, 0.15, 0.3])
def test_an_upload_that_is_killed_leaves_no_object(s3_store, s3_place, tmp_path, after_s):
    source = tmp_path / "large"
    source.write_bytes(os.urandom(96 * MIB))
    process = spawn(_upload, again(s3_store), source)
    deadline = time.monotonic() + 60.0
    folder = s3_store._folder.with_name("another machine")
    while not folder.exists() and process.is_alive() and time.monotonic() < deadline:
        time.sleep(0.005)  # it is made when the store is opened
    time.sleep(after_s)
    os.kill(process.pid, signal.SIGKILL)
    process.join()
    if process.exitcode == 0:
        pytest.skip("it was faster")
    assert not s3_store.exists("uploads/torn") and list(s3_store.list()) == []
    assert source.exists()


def test_conditional_puts_are_refused_by_the_server_itself(s3_store):
    client = s3_store._client
    tag = client.replace("a", b"1", None)
    with pytest.raises(ChangedError):
        client.replace("a", b"2", None)
    newer = client.replace("a", b"3", tag)
    with pytest.raises(ChangedError):
        client.replace("a", b"4", tag)
    assert client.get("a") == (b"3", newer)
    client.delete(["a"])
    with pytest.raises(ChangedError):
        client.replace("a", b"5", newer)


def test_a_lease_lives_as_long_as_its_holder(s3_store, elsewhere, monkeypatch):
    """Held for several times as long as it would live without being renewed."""
    monkeypatch.setattr(leases, "TTL_S", 0.6)
    monkeypatch.setattr(leases, "RENEW_S", 0.15)
    order = []

    def wait():
        with elsewhere.locked("meshes/a"):
            order.append("second")

    with s3_store.locked("meshes/a"):
        waiting = threading.Thread(target=wait)
        waiting.start()
        time.sleep(2.0)
        s3_store.put_bytes("meshes/a/x", b"still mine")
        order.append("first")
    waiting.join(10.0)
    assert order == ["first", "second"]


def test_a_holder_that_lost_its_lease_writes_nothing_any_more(s3_store, elsewhere, monkeypatch):
    monkeypatch.setattr(leases, "TTL_S", 0.3)
    monkeypatch.setattr(leases, "RENEW_S", 0.6)  # too late: as if it had been stopped
    put_file(s3_store, "meshes/a/x", b"x")
    with s3_store.locked("meshes/a"):
        with elsewhere.locked("meshes/a"):
            time.sleep(1.0)
            for write in (
                lambda: s3_store.put_bytes("meshes/a/y", b"late"),
                lambda: s3_store.put_bytes("meshes/a/y", b"late", create_only=True),
                lambda: put_file(s3_store, "meshes/a/y", b"late"),
                lambda: s3_store.delete("meshes/a/x"),
                lambda: s3_store.delete_prefix("meshes/a/"),
            ):
                with pytest.raises(StoreUnavailableError):
                    write()
            elsewhere.put_bytes("meshes/a/z", b"mine")
        assert list(s3_store.list("meshes/")) == ["meshes/a/x", "meshes/a/z"]
    s3_store.put_bytes("meshes/a/y", b"without a lock")


def test_a_holder_that_cannot_renew_stops_writing_before_another_may_hold(s3_store, monkeypatch):
    assert leases.SAFE_S + 2.0 * s3_client.QUICK_S < leases.TTL_S
    assert 2.0 * leases.RENEW_S < leases.SAFE_S
    monkeypatch.setattr(leases, "SAFE_S", 0.2)
    with s3_store.locked("meshes/a"):
        time.sleep(0.3)
        with pytest.raises(StoreUnavailableError):
            s3_store.put_bytes("meshes/a/y", b"late")


def _die_holding(store, key):
    with store().locked(key):
        os._exit(1)


def test_a_lock_that_a_dead_process_of_this_machine_held_is_taken_over_at_once(s3_store, elsewhere, s3_place):
    process = spawn(_die_holding, partial(S3Store, s3_place, s3_store._folder, MIB), "meshes/a")
    process.join(60)
    began = time.monotonic()
    with s3_store.locked("meshes/a"):
        assert time.monotonic() - began < leases.TTL_S / 3
        waiting = threading.Thread(target=_take, args=(elsewhere, "meshes/a"))
        waiting.start()
        waiting.join(0.5)
        assert waiting.is_alive()
    waiting.join(10.0)
    assert not waiting.is_alive()


def _take(store, key):
    with store.locked(key):
        pass


def test_keys_that_share_a_lock_of_the_store_share_one_of_the_machine():
    assert LOCK_OBJECTS % LOCK_FILES == 0


def test_an_answer_to_taking_a_lock_may_be_lost(s3_store, monkeypatch):
    replace, failed = S3Client.replace, []

    def lossy(client, key, data, tag):
        answer = replace(client, key, data, tag)
        if not failed:
            failed.append(key)
            raise ChangedError  # what the library's second try is told
        return answer

    monkeypatch.setattr(S3Client, "replace", lossy)
    with s3_store.locked("meshes/a"):
        assert failed
        s3_store.put_bytes("meshes/a/x", b"mine")


def test_many_locks_leave_few_objects_that_are_no_keys(s3_store):
    for number in range(20):
        with s3_store.locked(f"meshes/{number}"):
            pass
    assert list(s3_store.list()) == [] and list(s3_store.children("meshes/")) == []
    assert 0 < len(list(s3_store._client.list(".locks"))) <= 20


def calls(store):
    """One of each kind."""
    return (partial(store.get_bytes, "a"), partial(store.put_bytes, "b", b""), partial(store.exists, "a"), lambda: list(store.list()))


def test_a_store_that_is_away_is_said_to_be_and_comes_back(tmp_path, monkeypatch):
    for name, value in CREDENTIALS.items():
        monkeypatch.setenv(name, value)
    monkeypatch.setattr(s3_client, "QUICK_S", 0.5)
    with S3Server() as server:
        store = S3Store(S3Place(BUCKET, "p", server.endpoint), tmp_path, MIB)
        store.put_bytes("a", b"kept")
        server.pause()
        began = time.monotonic()
        for call in (
            lambda: store.get_bytes("a"),
            lambda: store.exists("a"),
            lambda: list(store.list()),
            lambda: store.put_bytes("b", b""),
        ):
            with pytest.raises(StoreUnavailableError) as fault:
                call()
            assert fault.value.retry_after_s >= 1.0
        assert time.monotonic() - began < 10.0
        server.resume()
        assert store.get_bytes("a") == b"kept"
    with pytest.raises(StoreUnavailableError):
        store.get_bytes("a")


def test_a_lock_survives_a_store_that_is_away_for_a_moment(tmp_path, monkeypatch):
    for name, value in CREDENTIALS.items():
        monkeypatch.setenv(name, value)
    monkeypatch.setattr(s3_client, "QUICK_S", 1.0)
    monkeypatch.setattr(leases, "RENEW_S", 0.1)
    with S3Server() as server:
        store = S3Store(S3Place(BUCKET, "p", server.endpoint), tmp_path, MIB)
        with store.locked("meshes/a"):
            server.pause()
            time.sleep(2.5)
            server.resume()
            time.sleep(0.5)
            store.put_bytes("meshes/a/x", b"mine")
        with store.locked("meshes/a"):
            assert store.get_bytes("meshes/a/x") == b"mine"


def test_wrong_credentials_are_said_without_saying_them(tmp_path, monkeypatch, caplog):
    monkeypatch.setenv("AWS_ACCESS_KEY_ID", "AKIAWRONGWRONGWRONG1")
    monkeypatch.setenv("AWS_SECRET_ACCESS_KEY", "very-secret")
    monkeypatch.setenv("AWS_REGION", "us-east-1")
    with S3Server({"INITIAL_NO_AUTH_ACTION_COUNT": "0"}) as server, caplog.at_level(logging.DEBUG):
        store = S3Store(S3Place(BUCKET, "p", server.endpoint), tmp_path, MIB)
        for call in (
            lambda: store.get_bytes("a"),
            lambda: store.put_bytes("a", b""),
            lambda: store.exists("a"),
            lambda: list(store.list()),
        ):
            with pytest.raises(StoreUnavailableError, match="refuses") as fault:
                call()
            assert fault.value.__cause__ is None and fault.value.__suppress_context__
    assert "very-secret" not in caplog.text and "AKIAWRONG" not in caplog.text


def test_a_bucket_that_is_not_there_is_no_empty_store(s3_place, tmp_path):
    store = S3Store(S3Place("no-such-bucket", "p", s3_place.endpoint), tmp_path, MIB)
    for call in (lambda: store.get_bytes("a"), lambda: store.put_bytes("a", b""), lambda: list(store.list()), store.check):
        with pytest.raises(StoreUnavailableError, match="bucket"):
            call()


def _ask_in_a_fork(store, answers):
    opened = store()
    opened.exists("a")
    child = os.fork()
    if child == 0:
        try:
            opened.exists("a")
        except RuntimeError as error:
            answers.put(str(error))
            answers.close()
            answers.join_thread()
        finally:
            os._exit(0)
    os.waitpid(child, 0)


def test_asking_in_a_fork_of_a_process_that_asked_is_an_error_and_no_hang(s3_store):
    answers = multiprocessing.get_context("spawn").Queue()
    process = spawn(_ask_in_a_fork, again(s3_store), answers)
    assert "forked" in answers.get(timeout=60)
    process.join(30)
    assert process.exitcode == 0


def test_a_full_disk_makes_room_by_removing_copies(s3_place, s3_store, small_disk):
    store = S3Store(s3_place, small_disk / "cache", 64 * MIB)
    for number in range(2):
        put_file(s3_store, f"uploads/{number}", os.urandom(600_000))
    first = store.local_path("uploads/0")
    with pytest.raises(StorageFullError):
        store.local_path("uploads/1")  # the first may not be mapped yet
    aged(first)
    assert store.local_path("uploads/1").stat().st_size == 600_000
    assert not first.exists()
    put_file(s3_store, "uploads/large", bytes(2 * MIB))
    with pytest.raises(StorageFullError):
        store.local_path("uploads/large")
    assert len(copies(store)) == 1 and store.sweep_temporary(-1.0) == 0


def test_a_store_of_an_authority_of_its_own_is_reached_by_its_certificate(s3_place, s3_store, tmp_path):
    tls = pytest.importorskip("tests.tls", reason="the package cryptography is not installed")
    ca_file, certificate = tls.make_authority(tmp_path, "127.0.0.1")
    host, _, port = s3_place.endpoint.removeprefix("http://").partition(":")
    s3_store.put_bytes("a", b"kept")
    with tls.TlsRelay(certificate, (host, int(port))) as secure_port:
        place = replace(s3_place, endpoint=f"https://127.0.0.1:{secure_port}")
        assert S3Store(replace(place, ca_file=ca_file), tmp_path / "trusting", MIB).get_bytes("a") == b"kept"
        with pytest.raises(StoreUnavailableError):
            S3Store(place, tmp_path / "doubting", MIB).get_bytes("a")


def test_the_usual_variables_say_where_a_store_is(s3_place, s3_store, tmp_path, monkeypatch):
    s3_store.put_bytes("a", b"kept")
    monkeypatch.setenv("AWS_ENDPOINT_URL_S3", s3_place.endpoint)
    assert S3Store(replace(s3_place, endpoint=None), tmp_path, MIB).get_bytes("a") == b"kept"
