import threading

import pytest

from backend import records
from backend.audit import audit
from schemas import keys
from schemas.errors import CancelledError, CorruptArtifactError, NotFoundError
from schemas.manifest import Manifest
from tests.backend.accepting import accept, record


def everything(store):
    return list(store.list())


def test_acceptance_is_upload_then_record_and_happens_once(store):
    mesh_id = accept(store, b"bytes")
    accepted = records.read_accepted(store, mesh_id)
    assert store.get_bytes(keys.upload(accepted.upload_sha256)) == b"bytes"
    assert accept(store, b"bytes", name="other-name.stl") == mesh_id
    assert records.read_accepted(store, mesh_id).name == "a.stl"
    assert [found for found, _ in records.outlines(store)] == [mesh_id]


def test_options_make_another_mesh_of_the_same_upload(store):
    first, second = accept(store), accept(store, hull_faces=500)
    assert first != second
    assert len(list(store.children(keys.UPLOADS))) == 1


def test_forgetting_leaves_nothing_and_keeps_a_shared_upload(store):
    first, second = accept(store), accept(store, hull_faces=500)
    record(store, first, "load")
    assert records.forget(store, first)
    assert not records.forget(store, first)
    assert not records.is_accepted(store, first)
    assert records.read_stage(store, first, "load") is None
    assert len(list(store.children(keys.UPLOADS))) == 1
    assert records.forget(store, second)
    assert everything(store) == []


def test_nothing_can_be_published_for_a_forgotten_mesh(store):
    mesh_id = accept(store)
    records.forget(store, mesh_id)
    with pytest.raises(CancelledError), records.publishing(store, mesh_id):
        raise AssertionError("unreachable")


def test_forgetting_waits_for_a_publication_and_then_removes_it(store):
    mesh_id = accept(store)
    with records.publishing(store, mesh_id):
        deleting = threading.Thread(target=records.forget, args=(store, mesh_id))
        deleting.start()
        store.put_bytes(keys.artifact(mesh_id, "hull.glb"), b"glTF")
        deleting.join(0.1)
        assert deleting.is_alive()
    deleting.join(10)
    assert everything(store) == []


def test_the_manifest_is_written_once(store):
    mesh_id = accept(store)
    ready = Manifest(id=mesh_id, status="ready", finished="2026-01-01T00:00:00Z")
    with records.publishing(store, mesh_id):
        assert records.write_manifest(store, ready)
        assert not records.write_manifest(store, ready.model_copy(update={"status": "failed"}))
    assert records.read_manifest(store, mesh_id) == ready
    names = {keys.ACCEPTED: keys.accepted(mesh_id), keys.MANIFEST: keys.manifest(mesh_id)}
    assert list(records.outlines(store)) == [(mesh_id, {name: store.version(key) for name, key in names.items()})]


def test_unknown_meshes_have_no_records(store):
    with pytest.raises(NotFoundError):
        records.read_accepted(store, "0" * 32)
    assert records.read_manifest(store, "0" * 32) is None
    assert records.read_stage(store, "0" * 32, "load") is None
    assert not records.forget(store, "0" * 32)


def test_a_damaged_stage_record_counts_as_none_and_damaged_acceptance_hides_no_other(store):
    mesh_id, other = accept(store, b"1"), accept(store, b"2")
    store.put_bytes(keys.stage_record(mesh_id, "load"), b"{")
    assert records.read_stage(store, mesh_id, "load") is None
    store.put_bytes(keys.accepted(mesh_id), b"{}")
    with pytest.raises(CorruptArtifactError):
        records.read_accepted(store, mesh_id)
    assert records.read_accepted(store, other).id == other


def test_sweeping_removes_what_an_interrupted_deletion_or_acceptance_left(store):
    kept = accept(store, b"kept")
    record(store, kept, "load")
    before = everything(store)
    store.put_bytes(keys.upload("f" * 64), b"accepted never")
    store.put_bytes(keys.artifact("e" * 32, "hull.glb"), b"deleted half")
    audit(store, measure=False)
    store.delete(keys.USES_COMPLETE)
    assert everything(store) == before


def test_a_mesh_accepted_after_an_interrupted_deletion_keeps_nothing_of_what_that_left(store):
    mesh_id = accept(store)
    store.put_bytes(keys.artifact(mesh_id, "mesh.st"), b"tensors")
    record(store, mesh_id, "load")
    upload = records.read_accepted(store, mesh_id).upload_sha256
    store.delete(keys.accepted(mesh_id))  # a deletion that was killed after its first steps
    store.delete(keys.artifact(mesh_id, "mesh.st"))
    assert accept(store) == mesh_id
    assert everything(store) == [
        keys.accepted(mesh_id),
        keys.unfinished(mesh_id),
        keys.upload(upload),
        keys.use(upload, mesh_id),
    ]
