import multiprocessing
import os
import resource
import signal
import tempfile
import threading
import time
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from backend.store import KEY, Store
from schemas import keys
from schemas.errors import NotFoundError, StorageFullError


def files_under(folder):
    return sorted(str(p.relative_to(folder)) for p in folder.rglob("*") if p.is_file() and ".locks" not in p.parts)


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
    assert files_under(store.root) == ["a"]


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


def test_put_file_moves_within_the_file_system(store):
    with store.temporary() as file:
        file.write(b"stream" * 1000)
        file.flush()
        store.put_file("uploads/u", store.root / file.name)
    assert store.get_bytes("uploads/u") == b"stream" * 1000
    assert files_under(store.root) == ["uploads/u"]


def test_put_file_copies_from_another_file_system(store, tmp_path):
    other = Path("/dev/shm")
    if not os.access(other, os.W_OK) or other.stat().st_dev == store.root.stat().st_dev:
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
    for call in (store.exists, store.get_bytes, store.local_path, store.delete, lambda k: store.put_bytes(k, b"")):
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
    assert not (store.root / "meshes" / "a").exists()
    with pytest.raises(ValueError, match="slash"):
        store.delete_prefix("meshes/a")


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


def test_a_folder_that_another_process_makes_and_prunes_meanwhile_loses_nothing(store, monkeypatch):
    mkdir, others = Path.mkdir, []

    def made_and_pruned_by_another(path, *arguments, **options):
        if path.name == "shared" and not others:
            others.append(path)
            raise FileExistsError(path)  # it was there when this process asked, and is gone again
        mkdir(path, *arguments, **options)

    monkeypatch.setattr(Path, "mkdir", made_and_pruned_by_another)
    assert store.put_bytes("meshes/shared/a", b"x")
    assert others
    assert store.get_bytes("meshes/shared/a") == b"x"


def test_an_interrupted_stream_leaves_nothing(store):
    with pytest.raises(RuntimeError, match="client left"), store.temporary() as file:
        file.write(b"half")
        raise RuntimeError("client left")
    assert files_under(store.root) == []


def _fill(root, key, results):
    signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1 << 16, 1 << 16))
    store = Store(root)
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
        store.put_file(key, store.root / file.name)


def test_no_room_is_storage_full_with_nothing_half_written(store):
    """The file size limit stands in for a full disk: the write fails part way, as it does there."""
    store.put_bytes("meshes/a/old", b"still here")
    context = multiprocessing.get_context("spawn")
    results = context.Queue()
    process = context.Process(target=_fill, args=(store.root, "meshes/a/new", results))
    process.start()
    assert [results.get(timeout=30), results.get(timeout=30)] == ["StorageFullError", "StorageFullError"]
    process.join()
    assert files_under(store.root) == ["meshes/a/old"]
    assert store.get_bytes("meshes/a/old") == b"still here"


def test_a_full_disk_is_storage_full_and_recovers(small_disk):
    store = Store(small_disk / "store")
    with pytest.raises(StorageFullError):
        store.put_bytes("meshes/a/big", b"x" * (2 << 20))
    assert files_under(store.root) == []
    assert store.put_bytes("meshes/a/small", b"x" * 1000)
    with pytest.raises(StorageFullError), store.temporary() as file:
        for _ in range(64):
            file.write(b"x" * (1 << 16))
    assert files_under(store.root) == ["meshes/a/small"]


def _hold(root, key, entered, log):
    with Store(root).locked(key):
        entered.set()
        time.sleep(0.3)
        log.put(time.time())


def test_a_lock_holds_across_processes_and_is_freed_by_death(store):
    context = multiprocessing.get_context("spawn")
    entered, log = context.Event(), context.Queue()
    process = context.Process(target=_hold, args=(store.root, "meshes/a", entered, log))
    process.start()
    assert entered.wait(30)
    with store.locked("meshes/a"):
        assert log.get(timeout=5) <= time.time()
    process.join()
    entered.clear()
    process = context.Process(target=_hold, args=(store.root, "meshes/a", entered, log))
    process.start()
    assert entered.wait(30)
    process.kill()
    with store.locked("meshes/a"):
        pass
    process.join()


def test_old_temporary_files_are_swept_and_young_ones_stay(store):
    old, young = store.root / ".tmp" / "old", store.root / ".tmp" / "young"
    for path in (old, young):
        path.write_bytes(b"torso")
    os.utime(old, (time.time() - 7200, time.time() - 7200))
    assert store.sweep_temporary(3600) == 1
    assert files_under(store.root) == [".tmp/young"]
    assert list(store.list()) == []


def test_version_changes_with_every_writing_and_is_none_without_an_object(store):
    assert store.version("a/b") is None
    seen = set()
    for _ in range(3):
        store.put_bytes("a/b", b"the same")
        assert store.version("a/b") == store.version("a/b")
        seen.add(store.version("a/b"))
    assert len(seen) == 3
    store.delete("a/b")
    assert store.version("a/b") is None
