"""Records and uploads that are not as they were written: said, never in the way of others, and made good by sending the same again."""

import numpy as np
import pytest

from backend import records
from backend.artifacts import read_artifact
from backend.audit import audit
from backend.damage import drop_damaged
from backend.s3_store import S3Store
from schemas import artifacts, keys
from schemas.errors import DamagedArtifactError, DamagedUploadError
from schemas.mesh import Problem
from tests.backend.accepting import LOAD_REPORT, accept, record, record_all
from tests.backend.test_damage import ready

DAMAGED = Problem(title="The stored upload is damaged", status=422, detail="Send it again.", code=DamagedUploadError.code)


def upload_of(store, mesh_id):
    return keys.upload(records.read_accepted(store, mesh_id).upload_sha256)


def flip(store, key):
    data = store.get_bytes(key)
    store.put_bytes(key, bytes([data[0] ^ 1]) + data[1:])


def test_sending_the_same_bytes_again_replaces_damaged_ones(store):
    mesh_id = accept(store, b"bytes")
    key = upload_of(store, mesh_id)
    flip(store, key)
    with pytest.raises(DamagedUploadError):
        records.upload_path(store, key.removeprefix(keys.UPLOADS))
    accept(store, b"bytes")
    assert store.get_bytes(key) == b"bytes"
    store.delete(key)
    accept(store, b"bytes")
    assert store.get_bytes(key) == b"bytes"


def test_the_same_bytes_with_other_options_replace_damaged_ones_too(store):
    key = upload_of(store, accept(store, b"bytes"))
    flip(store, key)
    accept(store, b"bytes", hull_faces=500)
    assert store.get_bytes(key) == b"bytes"


def test_a_mesh_that_failed_by_its_damaged_upload_is_in_work_again_when_that_is_sent_again(store, queue):
    mesh_id = accept(store, b"bytes")
    record(store, mesh_id, "load", outcome="failed", error=DAMAGED)
    queue.advance(mesh_id)
    assert records.read_manifest(store, mesh_id).error == DAMAGED
    accept(store, b"bytes")
    assert records.read_manifest(store, mesh_id) is None
    queue.advance(mesh_id)
    assert queue.queue.get_job_ids() == [f"{mesh_id}-load"]


def test_a_mesh_that_failed_for_another_reason_stays_failed(store, queue):
    mesh_id = accept(store, b"bytes")
    record(store, mesh_id, "load", outcome="failed", error=DAMAGED.model_copy(update={"code": "no-faces"}))
    queue.advance(mesh_id)
    accept(store, b"bytes")
    assert records.read_manifest(store, mesh_id).status == "failed"


def test_a_torn_acceptance_stops_neither_reconciling_nor_sweeping_and_keeps_every_upload(store, queue):
    torn, other = accept(store, b"1"), accept(store, b"2")
    key = upload_of(store, torn)
    store.put_bytes(keys.accepted(torn), store.get_bytes(keys.accepted(torn))[:40])
    assert queue.reconcile() == 2
    assert set(queue.queue.get_job_ids()) == {f"{torn}-load", f"{other}-load"}
    audit(store, measure=False)
    assert store.exists(key)


def test_a_torn_acceptance_is_written_anew_when_the_same_is_sent_again_and_what_was_made_stays(store):
    mesh_id = accept(store, b"1")
    before = records.read_accepted(store, mesh_id)
    record(store, mesh_id, "load", report=LOAD_REPORT)
    store.put_bytes(keys.accepted(mesh_id), b"")
    with pytest.raises(DamagedUploadError):
        records.read_accepted(store, mesh_id)
    accept(store, b"1")
    assert records.read_accepted(store, mesh_id).model_copy(update={"created": before.created}) == before
    assert records.read_stage(store, mesh_id, "load") is not None


def test_a_mesh_with_a_torn_acceptance_can_be_deleted_and_its_upload_is_swept(store):
    mesh_id = accept(store, b"1")
    store.put_bytes(keys.accepted(mesh_id), b"{")
    assert records.forget(store, mesh_id)
    audit(store, measure=False)
    assert list(store.list()) == [keys.USES_COMPLETE]


@pytest.mark.parametrize("measure", [False, True])
def test_a_torn_manifest_is_made_again_of_the_records(store, queue, measure):
    mesh_id, other = sorted([accept(store, b"1"), accept(store, b"2")])
    queue.measure = measure
    record_all(store, mesh_id)
    queue.advance(mesh_id)
    whole = records.read_manifest(store, mesh_id)
    store.put_bytes(keys.manifest(mesh_id), store.get_bytes(keys.manifest(mesh_id))[:-20])
    with pytest.raises(DamagedArtifactError):
        records.read_manifest(store, mesh_id)
    assert queue.reconcile() == 1 + measure
    assert f"{other}-load" in queue.queue.get_job_ids()
    if not measure:  # whoever reads it next says so
        assert queue.rebuild(mesh_id) == []
    assert records.read_manifest(store, mesh_id).model_copy(update={"finished": whole.finished}) == whole


def test_damaged_copies_are_dropped_and_downloaded_again_before_anything_counts_as_damaged(s3_place, s3_store, tmp_path):
    """An artifact and an upload, damaged on the disk of the machine that reads it."""
    machine = S3Store(s3_place, tmp_path / "machine", 64 << 20)
    mesh_id = ready(s3_store)
    key = upload_of(s3_store, mesh_id)

    def damage_copies():
        for copy in (tmp_path / "machine" / "copies").iterdir():
            copy.write_bytes(copy.read_bytes()[:-1] + b"\xff")

    expected = {name: np.array(tensor) for name, tensor in read_artifact(machine, mesh_id, artifacts.HULL_SEQUENCE).items()}
    records.upload_path(machine, key.removeprefix(keys.UPLOADS))
    damage_copies()
    found = read_artifact(machine, mesh_id, artifacts.HULL_SEQUENCE)
    assert all((found[name] == expected[name]).all() for name in expected)
    assert records.upload_path(machine, key.removeprefix(keys.UPLOADS)).read_bytes() == b"bytes"
    damage_copies()
    assert drop_damaged(machine, mesh_id) == []
