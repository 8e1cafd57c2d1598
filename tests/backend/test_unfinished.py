"""Marks of unfinished meshes: where they are, and what becomes of a mesh whose process dies between two writes."""

import os

import pytest

from backend import records, unfinished
from backend.damage import drop_damaged
from backend.local_store import LocalStore
from backend.queue import JobQueue
from schemas import keys
from schemas.errors import DamagedUploadError, StorageFullError
from schemas.jobs import LATER_STAGES
from schemas.mesh import Problem
from tests.backend.accepting import accept, record, record_all

DAMAGED = Problem(title="The stored upload is damaged", status=422, detail="Send it again.", code=DamagedUploadError.code)


def marked(store):
    return [mesh_id for mesh_id, _ in unfinished.marked(store)]


def ready(store, queue):
    mesh_id = accept(store)
    record_all(store, mesh_id)
    queue.advance(mesh_id)
    assert marked(store) == []
    return mesh_id


def test_a_mesh_is_marked_from_its_acceptance_until_it_is_ready(store, queue):
    mesh_id = accept(store)
    assert marked(store) == [mesh_id]
    queue.advance(mesh_id)
    record_all(store, mesh_id)
    assert marked(store) == [mesh_id]
    queue.advance(mesh_id)
    assert records.read_manifest(store, mesh_id).status == "ready"
    assert marked(store) == []


def test_sending_a_finished_mesh_again_marks_nothing(store, queue):
    assert ready(store, queue) == accept(store)
    assert marked(store) == []


def test_where_later_stages_are_wanted_a_mesh_is_marked_until_they_have_ended(store, connection):
    queue = JobQueue(connection, store, measure=True)
    mesh_id = accept(store)
    record_all(store, mesh_id)
    for stage in LATER_STAGES:
        queue.advance(mesh_id)
        assert marked(store) == [mesh_id]
        record(store, mesh_id, stage)
    queue.advance(mesh_id)
    assert marked(store) == []


def test_a_failed_mesh_has_no_mark_until_its_damaged_upload_is_sent_again(store, queue):
    mesh_id = accept(store)
    record(store, mesh_id, "load", outcome="failed", error=DAMAGED)
    queue.advance(mesh_id)
    assert records.read_manifest(store, mesh_id).status == "failed"
    assert marked(store) == []
    accept(store)
    assert marked(store) == [mesh_id]


@pytest.mark.parametrize("key", [keys.manifest, lambda mesh_id: keys.artifact(mesh_id, "hull.glb")])
def test_a_mesh_with_a_damaged_file_is_marked_again(store, queue, key):
    mesh_id = accept(store)
    record_all(store, mesh_id)
    record(store, mesh_id, "bake", artifacts={"hull.glb": "0" * 64})
    queue.advance(mesh_id)
    store.put_bytes(key(mesh_id), b"torn")
    drop_damaged(store, mesh_id)
    assert marked(store) == [mesh_id]
    assert records.read_manifest(store, mesh_id) is None


def test_a_mark_that_is_there_for_nothing_is_taken_away(store, queue):
    mesh_id = ready(store, queue)
    unfinished.mark(store, mesh_id)
    assert queue.reconcile() == 0
    assert marked(store) == []


def test_a_mark_is_not_taken_from_a_mesh_that_is_in_work_again(store, queue):
    mesh_id = ready(store, queue)
    with records.publishing(store, mesh_id):
        unfinished.mark(store, mesh_id)
        store.delete(keys.manifest(mesh_id))
    records.settle(store, mesh_id, ())
    assert marked(store) == [mesh_id]


def test_meshes_that_have_lost_their_marks_or_never_had_one_are_found_by_going_through_everything(store, queue):
    finished, waiting, loaded = ready(store, queue), accept(store, b"2"), accept(store, b"3")
    record(store, loaded, "load")
    store.delete_prefix(keys.UNFINISHED)
    assert queue.reconcile() == 0
    queue.audit(3600.0)
    assert set(marked(store)) == {waiting, loaded}
    assert queue.reconcile() == 2
    assert finished not in str(queue.queue.get_job_ids())


def test_meshes_that_are_ready_are_found_where_later_stages_are_wanted_from_now_on_and_failed_ones_are_not(store, queue, connection):
    mesh_id, failed = ready(store, queue), accept(store, b"2")
    record(store, failed, "load", outcome="failed", error=DAMAGED)
    queue.advance(failed)
    queue.audit(3600.0)
    assert marked(store) == []
    measuring = JobQueue(connection, store, measure=True)
    measuring.audit(3600.0)
    assert marked(store) == [mesh_id]
    assert measuring.reconcile() == 1


def test_a_mark_without_an_acceptance_is_removed_once_nobody_can_be_about_to_accept(store, queue, monkeypatch):
    mesh_id = accept(store)
    store.delete(keys.accepted(mesh_id))
    queue.reconcile()
    assert marked(store) == [mesh_id]
    monkeypatch.setattr(unfinished, "ABANDONED_S", -60.0)
    queue.reconcile()
    assert list(store.list()) == []


def test_a_damaged_mark_is_a_mark(store, queue, monkeypatch):
    mesh_id = accept(store)
    store.put_bytes(keys.unfinished(mesh_id), b"../\xff")
    store.put_bytes(keys.unfinished("not-an-id"), b"")
    assert queue.reconcile() == 1
    monkeypatch.setattr(unfinished, "ABANDONED_S", -60.0)
    store.delete(keys.accepted(mesh_id))
    queue.reconcile()
    assert marked(store) == []


def test_what_is_abandoned_keeps_an_upload_that_another_mesh_has(store, queue, monkeypatch):
    first, second = accept(store), accept(store, hull_faces=500)
    store.delete(keys.accepted(first))
    monkeypatch.setattr(unfinished, "ABANDONED_S", -60.0)
    assert queue.reconcile() == 1
    assert marked(store) == [second]
    assert len(list(store.children(keys.UPLOADS))) == 1


class DiedError(BaseException):
    """A process that dies: nothing catches it."""


class MortalStore(LocalStore):
    """A store whose process dies before so many writes."""

    writes_left = 1 << 30

    def _write(self):
        if not self.writes_left:
            raise DiedError
        self.writes_left -= 1

    def put_bytes(self, key, data, *, create_only=False):
        self._write()
        return super().put_bytes(key, data, create_only=create_only)

    def put_file(self, key, source):
        self._write()
        super().put_file(key, source)

    def delete(self, key):
        if self.exists(key):
            self._write()
        return super().delete(key)


def fail_by_upload(store, queue):
    """A failed mesh that is in work again when it is sent again."""
    mesh_id = accept(store)
    record(store, mesh_id, "load", outcome="failed", error=DAMAGED)
    queue.advance(mesh_id)


def damage_it(store, queue):
    """A ready mesh with a file that is gone."""
    mesh_id = accept(store)
    record_all(store, mesh_id)
    record(store, mesh_id, "bake", artifacts={"hull.glb": "0" * 64})
    queue.advance(mesh_id)


def all_recorded(store, queue):
    record_all(store, accept(store))


CASES = {
    "accept": (lambda store, queue: None, lambda store, queue: accept(store)),
    "finish": (all_recorded, lambda store, queue: queue.advance(accept(store))),
    "send again": (fail_by_upload, lambda store, queue: accept(store)),
    "rebuild": (damage_it, lambda store, queue: queue.rebuild(next(iter(store.children(keys.MESHES))))),
    "delete ready": (ready, lambda store, queue: queue.cancel(next(iter(store.children(keys.MESHES))))),
    "delete in work": (all_recorded, lambda store, queue: queue.cancel(next(iter(store.children(keys.MESHES))))),
}


@pytest.mark.parametrize("case", CASES)
def test_whoever_dies_between_two_writes_leaves_no_unfinished_mesh_unmarked_and_no_rest_that_stays(case, connection, tmp_path, monkeypatch):
    """Nothing is known but the store: Redis forgets everything, too."""
    monkeypatch.setattr(unfinished, "ABANDONED_S", -60.0)
    prepare, act = CASES[case]
    writes = 0
    while True:
        store = MortalStore(tmp_path / f"{case}-{writes}")
        queue = JobQueue(connection, store)
        prepare(store, queue)
        queue.audit(3600.0)
        store.writes_left = writes
        try:
            act(store, queue)
        except DiedError:
            died = True
        else:
            died = False
        store.writes_left = 1 << 30
        connection.flushall()
        check_what_is_left(store, queue)
        if not died:
            break
        writes += 1
    assert writes > 1


def check_what_is_left(store, queue):
    accepted = [mesh_id for mesh_id in store.children(keys.MESHES) if records.is_accepted(store, mesh_id)]
    for mesh_id in accepted:
        assert records.read_manifest(store, mesh_id) is not None or marked(store) == [mesh_id]
    in_work = queue.reconcile()
    assert in_work == sum(records.read_manifest(store, mesh_id) is None for mesh_id in accepted)
    assert bool(queue.queue.get_job_ids()) == bool(in_work)
    assert len(marked(store)) == in_work
    if not accepted:  # but for an upload alone, which no mark was put for yet
        assert all(key.startswith(keys.UPLOADS) or key == keys.USES_COMPLETE for key in store.list())
    queue.audit(3600.0)
    assert sorted(store.children(keys.MESHES)) == accepted
    assert len(list(store.children(keys.UPLOADS))) == len(list(store.list(keys.USES))) == len(accepted)


def test_a_full_disk_keeps_nobody_from_deleting(small_disk, connection):
    store = LocalStore(small_disk / "store")
    queue = JobQueue(connection, store)
    mesh_id = ready(store, queue)
    with pytest.raises(StorageFullError):
        for number in range(10_000):
            store.put_bytes(f"filling/{number}", os.urandom(65_536 if number < 12 else 512))
    assert records.forget(store, mesh_id)
    store.delete_prefix("filling/")
    assert list(store.list()) == []
