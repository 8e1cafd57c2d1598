"""Flipped bytes: found wherever they are, and made good."""

import hashlib

import numpy as np
import pytest

from backend import records
from backend.artifacts import open_artifact, read_artifact, write_artifact
from backend.damage import drop_damaged, is_sound
from backend.local_store import LocalStore
from schemas import artifacts, keys
from schemas.errors import CancelledError, CorruptArtifactError, DamagedArtifactError
from schemas.jobs import STAGES
from schemas.manifest import Manifest, StageRecord
from tests.backend.accepting import accept

SEQUENCE = {
    "step_vertices": np.arange(4, dtype=np.int32).reshape(2, 2),
    "step_positions": np.ones((2, 3), np.float32),
    "level_faces": np.array([8], np.int32),
    "level_steps": np.array([1], np.int32),
}


@pytest.fixture
def store(tmp_path):
    return LocalStore(tmp_path)


def flip(path, at, bits=0x10):
    data = bytearray(path.read_bytes())
    data[at] ^= bits
    path.write_bytes(data)


def ready(store):
    """A mesh all of whose stages have a record, that of the hull with an artifact and a download."""
    mesh_id = accept(store, b"bytes", name="a.ply")
    for stage in STAGES:
        files = {}
        if stage == "hull":
            files[artifacts.HULL_SEQUENCE.file] = write_artifact(store, mesh_id, artifacts.HULL_SEQUENCE, SEQUENCE, "hull")
        records.write_stage(store, mesh_id, StageRecord(stage=stage, outcome="done", seconds=0.1, artifacts=files))
    assert records.write_manifest(store, Manifest(id=mesh_id, status="ready"))
    return mesh_id


def path_of(store, mesh_id):
    return store.local_path(keys.artifact(mesh_id, artifacts.HULL_SEQUENCE.file))


def test_every_flipped_byte_of_an_artifact_is_detected_or_changes_no_tensor(store):
    mesh_id = ready(store)
    path = path_of(store, mesh_id)
    original = path.read_bytes()
    undetected = 0
    for at in range(len(original)):
        for bits in (0x01, 0x80):
            flip(path, at, bits)
            try:
                found = open_artifact(path, artifacts.HULL_SEQUENCE, verify=True)
            except CorruptArtifactError:
                found = None
            if found is not None:
                undetected += 1
                assert found.keys() == SEQUENCE.keys()
                assert all(np.array_equal(found[name], SEQUENCE[name]) for name in SEQUENCE)
            path.write_bytes(original)
    assert undetected <= 2 * len(b"hull"), "only the text that says whose file it is may change unnoticed"


def test_a_damaged_artifact_is_not_read_and_names_its_mesh(store):
    mesh_id = ready(store)
    assert read_artifact(store, mesh_id, artifacts.HULL_SEQUENCE).keys() == SEQUENCE.keys()
    flip(path_of(store, mesh_id), -1)
    with pytest.raises(DamagedArtifactError) as caught:
        read_artifact(store, mesh_id, artifacts.HULL_SEQUENCE)
    assert caught.value.where["mesh"] == mesh_id and str(store.root) not in caught.value.message


def test_only_the_stage_of_a_damaged_file_its_check_and_the_manifest_are_forgotten(store):
    mesh_id = ready(store)
    flip(path_of(store, mesh_id), -1)
    assert drop_damaged(store, mesh_id) == ["hull", "verify"]
    assert not store.exists(keys.manifest(mesh_id))
    assert {stage for stage in STAGES if records.read_stage(store, mesh_id, stage) is None} == {"hull", "verify"}


def test_a_missing_file_is_damage(store):
    mesh_id = ready(store)
    path_of(store, mesh_id).unlink()
    assert drop_damaged(store, mesh_id) == ["hull", "verify"]


def test_a_sound_mesh_keeps_everything(store):
    mesh_id = ready(store)
    before = {key: store.get_bytes(key) for key in store.list()}
    assert drop_damaged(store, mesh_id) == []
    assert {key: store.get_bytes(key) for key in store.list()} == before


def test_a_damaged_file_of_a_later_stage_leaves_the_mesh_ready_but_no_longer_settled(store):
    mesh_id = ready(store)
    store.put_bytes(keys.artifact(mesh_id, "hull_1.safetensors"), b"torn")
    later = StageRecord(stage="hulls", outcome="done", seconds=0.1, artifacts={"hull_1.safetensors": "0" * 64})
    records.write_stage(store, mesh_id, later)
    version = store.version(keys.manifest(mesh_id))
    assert drop_damaged(store, mesh_id) == ["hulls"]
    assert store.version(keys.manifest(mesh_id)) not in (None, version)
    assert records.read_stage(store, mesh_id, "hull") is not None and records.read_stage(store, mesh_id, "hulls") is None


def test_a_flipped_byte_of_a_download_is_found(store):
    mesh_id = ready(store)
    store.put_bytes(keys.artifact(mesh_id, artifacts.NORMAL_PNG), b"picture")
    digests = {artifacts.NORMAL_PNG: hashlib.sha256(b"picture").hexdigest()}
    record = StageRecord(stage="bake", outcome="done", seconds=0.1, artifacts=digests)
    assert is_sound(store, mesh_id, record)
    flip(store.local_path(keys.artifact(mesh_id, artifacts.NORMAL_PNG)), 3)
    assert not is_sound(store, mesh_id, record)


def test_a_deleted_mesh_has_no_damage(store):
    mesh_id = ready(store)
    records.forget(store, mesh_id)
    with pytest.raises(CancelledError):
        drop_damaged(store, mesh_id)
