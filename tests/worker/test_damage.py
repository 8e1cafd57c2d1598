"""A flipped byte in any file that a mesh has: the stage that made it, and no other, makes it again."""

import pytest
import trimesh

from backend import records
from backend.queue import JobQueue
from backend.store import Store
from schemas import artifacts, keys
from schemas.errors import DamagedArtifactError
from schemas.jobs import STAGES
from service.embedded import EmbeddedBackend
from tests.backend.accepting import accept
from tests.meshes import bumpy_sphere, torus
from worker.jobs import run_and_record, run_stage
from worker.settings import WorkerSettings

pytestmark = pytest.mark.xdist_group("damage in a store")


@pytest.fixture(scope="module")
def queue(tmp_path_factory):
    """The queue of a private server without workers."""
    folder = tmp_path_factory.mktemp("data")
    backend = EmbeddedBackend(folder, 0)
    backend.start()
    yield JobQueue.open(WorkerSettings(data_dir=folder, redis_url=backend.redis_url))
    backend.stop()


@pytest.fixture(scope="module")
def mesh_id(queue):
    """A ready mesh with every artifact that stages before `verify` make."""
    data = trimesh.Trimesh(*torus(46, 22), process=False).export(file_type="ply")
    mesh_id = accept(queue.store, data, name="a.ply", hull_faces=400, texels=64)
    for stage in STAGES:
        assert run_and_record(queue, mesh_id, stage).outcome == "done"
    queue.advance(mesh_id)
    assert records.read_manifest(queue.store, mesh_id).status == "ready"
    return mesh_id


def files_of(store: Store, mesh_id: str) -> dict[str, str]:
    """File -> its stage."""
    manifest = records.read_manifest(store, mesh_id)
    return {name: record.stage for record in manifest.stages for name in record.artifacts}


def flip(store: Store, mesh_id: str, name: str) -> bytes:
    """Flip a bit of the last byte; the bytes before."""
    path = store.local_path(keys.artifact(mesh_id, name))
    before = path.read_bytes()
    path.write_bytes(before[:-1] + bytes([before[-1] ^ 4]))
    return before


def test_a_flipped_byte_in_any_file_of_a_mesh_is_made_good_by_its_stage_alone(queue, mesh_id):
    files = files_of(queue.store, mesh_id)
    expected = {layout.file for layout in artifacts.LAYOUTS[:7]} - {artifacts.APPEARANCE.file}
    assert expected | {artifacts.TREE.file, artifacts.HULL_GLB, artifacts.NORMAL_PNG, artifacts.LEVELS[0].file} <= files.keys()
    for name, stage in files.items():
        before = flip(queue.store, mesh_id, name)
        assert queue.rebuild(mesh_id) == [stage, "verify"], name
        assert records.read_manifest(queue.store, mesh_id) is None
        for again in (stage, "verify"):
            assert run_and_record(queue, mesh_id, again).outcome == "done"
        queue.advance(mesh_id)
        assert records.read_manifest(queue.store, mesh_id).status == "ready"
        assert queue.store.get_bytes(keys.artifact(mesh_id, name)) == before, name
    assert queue.rebuild(mesh_id) == []


def test_a_damaged_upload_fails_its_mesh_before_it_is_read_and_sending_it_again_makes_the_mesh(queue):
    data = trimesh.Trimesh(*bumpy_sphere(2), process=False).export(file_type="ply")
    options = {"name": "b.ply", "hull_faces": 60, "texels": 64}
    mesh_id = accept(queue.store, data, **options)
    key = keys.upload(records.read_accepted(queue.store, mesh_id).upload_sha256)
    queue.store.put_bytes(key, data[:-1] + bytes([data[-1] ^ 1]))
    assert run_and_record(queue, mesh_id, "load").outcome == "failed"
    queue.advance(mesh_id)
    manifest = records.read_manifest(queue.store, mesh_id)
    assert (manifest.status, manifest.error.status, manifest.error.model_extra["code"]) == ("failed", 422, "damaged-upload")
    assert "send the same file" in manifest.error.detail
    made_by_all_stages(queue, accept(queue.store, data, **options))


@pytest.mark.parametrize("stage", ["load", "hull"])
def test_a_torn_acceptance_fails_its_mesh_and_sending_the_upload_again_goes_on(queue, stage):
    data = trimesh.Trimesh(*bumpy_sphere(2, seed=5 + list(STAGES).index(stage)), process=False).export(file_type="ply")
    options = {"name": "c.ply", "hull_faces": 60, "texels": 64}
    mesh_id = accept(queue.store, data, **options)
    if stage == "hull":
        run_and_record(queue, mesh_id, "load")
    queue.store.put_bytes(keys.accepted(mesh_id), b'{"id":"')
    assert run_and_record(queue, mesh_id, stage).error.model_extra["code"] == "damaged-upload"
    queue.reconcile()
    assert records.read_manifest(queue.store, mesh_id).status == "failed"
    made_by_all_stages(queue, accept(queue.store, data, **options))


def made_by_all_stages(queue, mesh_id):
    assert records.read_manifest(queue.store, mesh_id) is None
    for stage in STAGES:
        if records.read_stage(queue.store, mesh_id, stage) is None:
            assert run_and_record(queue, mesh_id, stage).outcome == "done"
    queue.advance(mesh_id)
    assert records.read_manifest(queue.store, mesh_id).status == "ready"


def test_a_stage_whose_input_is_damaged_does_not_fail_the_mesh_but_has_the_input_made_again(queue, mesh_id, monkeypatch):
    monkeypatch.setenv("SILHOUETTE_DATA_DIR", str(queue.store.root.parent))
    connection = queue.redis.connection_pool.connection_kwargs
    monkeypatch.setenv("SILHOUETTE_REDIS_URL", f"unix://{connection['path']}")
    flip(queue.store, mesh_id, artifacts.MESH.file)
    queue.store.delete(keys.manifest(mesh_id))
    queue.store.delete(keys.stage_record(mesh_id, "tree"))
    with pytest.raises(DamagedArtifactError):
        run_and_record(queue, mesh_id, "tree")
    assert records.read_stage(queue.store, mesh_id, "tree") is None
    run_stage(mesh_id, "tree")
    assert records.read_stage(queue.store, mesh_id, "load") is None
    for stage in ("load", "tree", "verify"):
        run_stage(mesh_id, stage)
    assert records.read_manifest(queue.store, mesh_id).status == "ready"
