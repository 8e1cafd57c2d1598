import multiprocessing
import os
import resource
import signal
import tempfile
import threading
import time
from functools import partial
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from backend import leases
from backend.local_store import LocalStore
from backend.s3_store import S3Store
from backend.store import KEY
from schemas import keys
from schemas.errors import NotFoundError, StorageFullError


def files_under(folder):
    return sorted(str(p.relative_to(folder)) for p in folder.rglob("*") if p.is_file() and ".locks" not in p.parts)


@pytest.fixture
def local_store(tmp_path):
    return LocalStore(tmp_path / "store")


def test_what_is_put_is_got(store):
    assert store.put_bytes("meshes/a/x.bin", b"one")
    assert store.get_bytes("meshes/a/x.bin") == b"one"
    assert store.local_path("meshes/a/x.bin").read_bytes() == b"one"
    assert store.exists("meshes/a/x.bin")


def test_put_replaces_whole_objects(store):
    store.put_bytes("a", b"long content")
    store.put_bytes("a", b"b")
    assert store.get_bytes("a") == b"b"


def test_create_only_keeps_the_first(store):
    assert store.put_bytes("a", b"first", create_only=True)
    assert not store.put_bytes("a", b"second", create_only=True)
    assert store.get_bytes("a") == b"first"
    assert list(store.list()) == ["a"]


def test_create_only_has_one_winner_among_many_threads(store):
    won = []
    start = threading.Barrier(8)

    def put(number):
        start.wait()
        if store.put_bytes("contested", str(number).encode(), create_only=True):
            won.append(number)

    threads = [threading.Thread(target=put, args=(n,)) for n in range(8)]
    [t.start() for t in threads]
    [t.join() for t in threads]
    assert len(won) == 1
    assert store.get_bytes("contested") == str(won[0]).encode()


def put_file(store, key, data):
    with store.temporary() as file:
        file.write(data)
        file.flush()
        store.put_file(key, Path(file.name))


def test_a_file_that_is_put_is_got_and_nothing_temporary_stays(store):
    put_file(store, "uploads/u", b"stream" * 1000)
    assert store.get_bytes("uploads/u") == b"stream" * 1000
    assert store.local_path("uploads/u").read_bytes() == b"stream" * 1000
    assert list(store.list()) == ["uploads/u"]
    assert store.sweep_temporary(-1.0) == 0


def test_put_file_moves_within_the_file_system(local_store):
    put_file(local_store, "uploads/u", b"stream")
    assert files_under(local_store.root) == ["uploads/u"]


def test_put_file_copies_from_another_file_system(store, tmp_path):
    other = Path("/dev/shm")
    if not os.access(other, os.W_OK) or other.stat().st_dev == tmp_path.stat().st_dev:
        pytest.skip("needs a second file system")
    with tempfile.NamedTemporaryFile(dir=other) as source:
        source.write(b"elsewhere")
        source.flush()
        store.put_file("a/b", Path(source.name))
        assert Path(source.name).exists()
    assert store.get_bytes("a/b") == b"elsewhere"


def test_missing_objects_are_not_found(store):
    store.put_bytes("folder/object", b"")
    for key in ("nothing", "folder", "folder/object/below", "no/such/folder"):
        assert not store.exists(key)
        with pytest.raises(NotFoundError):
            store.get_bytes(key)
        with pytest.raises(NotFoundError):
            store.local_path(key)
        assert not store.delete(key)


@pytest.mark.parametrize(
    "key", ["", "/", "/etc/passwd", "../x", "a/../b", "a/..", "./a", "a//b", "a/", ".tmp/x", "a/.hidden", "a\n", "a\0b", "ä", "a b", "a\\b"]
)
def test_keys_that_could_leave_their_place_are_refused(store, key):
    for call in (store.exists, store.get_bytes, store.local_path, store.delete, store.version, lambda k: store.put_bytes(k, b"")):
        with pytest.raises(ValueError, match="not a key"):
            call(key)


@given(st.text())
def test_every_key_that_is_taken_stays_under_the_root(key):
    if KEY.fullmatch(key):
        parts = key.split("/")
        assert all(part and not part.startswith(".") and "\0" not in part for part in parts)


def test_the_schema_makes_keys_that_the_store_takes():
    mesh, upload = "0" * 32, "f" * 64
    for key in (
        keys.upload(upload),
        keys.accepted(mesh),
        keys.stage_record(mesh, "load"),
        keys.artifact(mesh, "hull.glb"),
        keys.manifest(mesh),
    ):
        assert KEY.fullmatch(key)


def test_list_and_children_and_delete_prefix(store):
    for key in ("meshes/a/1", "meshes/a/deep/2", "meshes/ab/3", "meshes/b/4", "uploads/5"):
        store.put_bytes(key, b"")
    assert list(store.list("meshes/a")) == ["meshes/a/1", "meshes/a/deep/2", "meshes/ab/3"]
    assert list(store.list("meshes/a/")) == ["meshes/a/1", "meshes/a/deep/2"]
    assert len(list(store.list())) == 5
    assert list(store.children("meshes/")) == ["a", "ab", "b"]
    assert list(store.children("nothing/")) == []
    assert store.delete_prefix("meshes/a/") == 2
    assert list(store.list("meshes/")) == ["meshes/ab/3", "meshes/b/4"]
    assert list(store.children("meshes/")) == ["ab", "b"]
    with pytest.raises(ValueError, match="slash"):
        store.delete_prefix("meshes/a")


def test_a_deleted_folder_leaves_no_empty_one(local_store):
    local_store.put_bytes("meshes/a/deep/1", b"")
    local_store.delete_prefix("meshes/a/")
    assert not (local_store.root / "meshes").exists()


def test_entries_know_versions_and_when_they_were_written(store):
    began = time.time()
    for key in ("meshes/a/1", "meshes/b/2"):
        store.put_bytes(key, key.encode())
    found = list(store.entries("meshes/"))
    assert [(entry.key, entry.version) for entry in found] == [(key, store.version(key)) for key in ("meshes/a/1", "meshes/b/2")]
    assert all(began - 2.0 < entry.written < time.time() + 2.0 for entry in found)


def test_versions_of_children_are_those_of_the_objects_asked_for(store):
    for key in ("meshes/a/x", "meshes/a/deep/y", "meshes/a/z", "meshes/b/z", "meshes/c/x", "uploads/x"):
        store.put_bytes(key, key.encode())
    assert dict(store.versions("meshes/", {"x", "deep/y"})) == {
        "a": {"x": store.version("meshes/a/x"), "deep/y": store.version("meshes/a/deep/y")},
        "b": {},
        "c": {"x": store.version("meshes/c/x")},
    }
    assert dict(store.versions("none/", {"x"})) == {}


def test_a_store_under_a_folder_is_one_of_its_own(store):
    inner = store.under("once")
    inner.put_bytes("uploads/a", b"inner")
    assert list(inner.list()) == ["uploads/a"] and not store.exists("uploads/a")
    assert store.get_bytes("once/uploads/a") == b"inner"
    inner.delete_prefix("uploads/")
    assert list(store.list()) == []


def test_a_check_leaves_nothing_behind(store):
    store.check()
    assert list(store.list()) == [] and store.sweep_temporary(-1.0) == 0


def test_putting_and_pruning_the_same_folder_at_once_loses_nothing(store):
    failures = []

    def churn(name):
        try:
            for _ in range(60):
                store.put_bytes(f"meshes/shared/{name}", b"x")
                assert store.exists(f"meshes/shared/{name}")
                store.delete(f"meshes/shared/{name}")
        except Exception as error:
            failures.append(error)

    threads = [threading.Thread(target=churn, args=(n,)) for n in "abc"]
    [t.start() for t in threads]
    [t.join() for t in threads]
    assert not failures


def test_a_folder_that_another_process_makes_and_prunes_meanwhile_loses_nothing(local_store, monkeypatch):
    mkdir, others = Path.mkdir, []

    def made_and_pruned_by_another(path, *arguments, **options):
        if path.name == "shared" and not others:
            others.append(path)
            raise FileExistsError(path)  # it was there when this process asked, and is gone again
        mkdir(path, *arguments, **options)

    monkeypatch.setattr(Path, "mkdir", made_and_pruned_by_another)
    assert local_store.put_bytes("meshes/shared/a", b"x")
    assert others
    assert local_store.get_bytes("meshes/shared/a") == b"x"


def test_an_interrupted_stream_leaves_nothing(store):
    with pytest.raises(RuntimeError, match="client left"), store.temporary() as file:
        file.write(b"half")
        raise RuntimeError("client left")
    assert list(store.list()) == [] and store.sweep_temporary(-1.0) == 0


def _fill(root, key, results):
    signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1 << 16, 1 << 16))
    store = LocalStore(root)
    for write in (lambda: store.put_bytes(key, b"x" * (1 << 20)), lambda: _stream(store, key)):
        try:
            write()
        except Exception as error:
            results.put(type(error).__name__)
        else:
            results.put("nothing raised")


def _stream(store, key):
    with store.temporary() as file:
        for _ in range(64):
            file.write(b"x" * (1 << 14))
        store.put_file(key, Path(file.name))


def test_no_room_is_storage_full_with_nothing_half_written(local_store):
    """The file size limit stands in for a full disk: the write fails part way, as it does there."""
    local_store.put_bytes("meshes/a/old", b"still here")
    context = multiprocessing.get_context("spawn")
    results = context.Queue()
    process = context.Process(target=_fill, args=(local_store.root, "meshes/a/new", results))
    process.start()
    assert [results.get(timeout=30), results.get(timeout=30)] == ["StorageFullError", "StorageFullError"]
    process.join()
    assert files_under(local_store.root) == ["meshes/a/old"]
    assert local_store.get_bytes("meshes/a/old") == b"still here"


def test_a_full_disk_is_storage_full_and_recovers(small_disk):
    store = LocalStore(small_disk / "store")
    with pytest.raises(StorageFullError):
        store.put_bytes("meshes/a/big", b"x" * (2 << 20))
    assert files_under(store.root) == []
    assert store.put_bytes("meshes/a/small", b"x" * 1000)
    with pytest.raises(StorageFullError), store.temporary() as file:
        for _ in range(64):
            file.write(b"x" * (1 << 16))
    assert files_under(store.root) == ["meshes/a/small"]


def _hold(store, key, entered, log):
    with store().locked(key):
        entered.set()
        time.sleep(0.3)
        log.put(time.time())


def again(store):
    """A function, for another process, that opens the same store."""
    if isinstance(store, LocalStore):
        return partial(LocalStore, store.root)
    return partial(S3Store, store._place, store._folder.with_name("another machine"), 1 << 20)


def spawn(target, *arguments):
    process = multiprocessing.get_context("spawn").Process(target=target, args=arguments)
    process.start()
    return process


def test_a_lock_holds_across_processes(store):
    context = multiprocessing.get_context("spawn")
    entered, log = context.Event(), context.Queue()
    process = spawn(_hold, again(store), "meshes/a", entered, log)
    assert entered.wait(30)
    with store.locked("meshes/a"):
        assert log.get(timeout=5) <= time.time()
    process.join()


def test_a_lock_is_freed_by_the_death_of_its_holder(store, monkeypatch):
    monkeypatch.setattr(leases, "TTL_S", 1.0)
    context = multiprocessing.get_context("spawn")
    entered, log = context.Event(), context.Queue()
    process = spawn(_hold, again(store), "meshes/a", entered, log)
    assert entered.wait(30)
    process.kill()
    process.join()
    with store.locked("meshes/a"):
        store.put_bytes("meshes/a", b"mine")
    assert log.empty()


def _count_up(store, key, times):
    opened = store()
    for _ in range(times):
        with opened.locked(key):
            number = int(opened.get_bytes(key))
            time.sleep(0.001)
            opened.put_bytes(key, str(number + 1).encode())


def test_processes_that_lock_lose_no_update(store):
    store.put_bytes("meshes/count", b"0")
    processes = [spawn(_count_up, again(store), "meshes/count", 8) for _ in range(3)]
    _count_up(lambda: store, "meshes/count", 8)
    [process.join() for process in processes]
    assert store.get_bytes("meshes/count") == b"32"


def _create(store, key, number, start, won):
    opened = store()
    start.wait(60)
    won.put((number, opened.put_bytes(key, str(number).encode(), create_only=True)))


def test_create_only_has_one_winner_among_processes(store):
    context = multiprocessing.get_context("spawn")
    start, answers = context.Barrier(3), context.Queue()
    processes = [spawn(_create, again(store), "contested", number, start, answers) for number in range(3)]
    won = [number for number, is_mine in (answers.get(timeout=60) for _ in processes) if is_mine]
    [process.join() for process in processes]
    assert len(won) == 1 and store.get_bytes("contested") == str(won[0]).encode()


def test_old_temporary_files_are_swept_and_young_ones_stay(local_store):
    old, young = local_store.root / ".tmp" / "old", local_store.root / ".tmp" / "young"
    for path in (old, young):
        path.write_bytes(b"torso")
    os.utime(old, (time.time() - 7200, time.time() - 7200))
    assert local_store.sweep_temporary(3600) == 1
    assert files_under(local_store.root) == [".tmp/young"]
    assert list(local_store.list()) == []


def test_version_changes_with_other_bytes_and_is_none_without_an_object(store):
    assert store.version("a/b") is None
    seen = set()
    for number in range(3):
        store.put_bytes("a/b", str(number).encode())
        assert store.version("a/b") == store.version("a/b")
        seen.add(store.version("a/b"))
    assert len(seen) == 3
    store.delete("a/b")
    assert store.version("a/b") is None
