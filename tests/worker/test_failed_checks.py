"""What a mesh loses when the stage `verify` finds an artifact wrong, and what its manifest tells when it finds none."""

import shutil

import numpy as np
import pytest

from backend import records
from backend.artifacts import open_artifact
from backend.local_store import LocalStore
from backend.queue import JobQueue
from backend.redis_connection import connect
from schemas import artifacts, keys
from schemas.jobs import STAGES
from tests.backend.accepting import accept
from tests.meshes import bumpy_sphere
from tests.worker.processing import ply
from worker import jobs as stage_jobs
from worker.jobs import run_and_record
from worker.stages import Result

pytestmark = pytest.mark.xdist_group("failed checks")


@pytest.fixture(scope="module")
def unchecked(server, tmp_path_factory):
    """(folder of a store, the mesh in it), all stages of which have ended but `verify`."""
    folder = tmp_path_factory.mktemp("unchecked")
    queue = JobQueue(connect(server.redis_url), LocalStore(folder))
    vertices, faces = bumpy_sphere(4)
    mesh_id = accept(queue.store, ply((vertices * 50.0, faces)), name="a.ply", hull_faces=200, texels=64)
    for stage in STAGES:
        if stage != "verify":
            assert run_and_record(queue, mesh_id, stage).outcome == "done"
    queue.redis.close()
    return folder, mesh_id


@pytest.fixture
def mesh_id(unchecked, queue):
    """That mesh, in the queue of this test."""
    folder, mesh_id = unchecked
    shutil.copytree(folder, queue.store.root, dirs_exist_ok=True)
    return mesh_id


def stored(queue, mesh_id, layout):
    return open_artifact(queue.store.local_path(keys.artifact(mesh_id, layout.file)), layout)


def test_an_artifact_that_fails_verification_takes_clipping_from_the_mesh(queue, mesh_id):
    hull = stored(queue, mesh_id, artifacts.HULL)
    shrunken = {**hull, "positions": np.asarray(hull["positions"]) * np.float32(0.9)}
    stage_jobs.publish(queue.store, mesh_id, "hull", Result(artifacts=[(artifacts.HULL, shrunken)]))
    assert run_and_record(queue, mesh_id, "verify").outcome == "done"
    queue.advance(mesh_id)
    manifest = records.read_manifest(queue.store, mesh_id)
    assert manifest.status == "ready"
    assert not manifest.capabilities["clip"].available
    assert "checks" in manifest.capabilities["clip"].reason
    assert manifest.capabilities["inner"].available


@pytest.mark.parametrize("name", ["faces", "edge_faces", "normals"])
def test_a_mesh_that_fails_verification_itself_fails(queue, mesh_id, name):
    mesh = stored(queue, mesh_id, artifacts.MESH)
    far_off = {**mesh, name: np.asarray(mesh[name]) + np.asarray(mesh[name]).dtype.type(10**9)}
    stage_jobs.publish(queue.store, mesh_id, "load", Result(artifacts=[(artifacts.MESH, far_off)]))
    record = run_and_record(queue, mesh_id, "verify")
    assert record.outcome == "failed" and "the mesh is wrong" in record.error.detail


def pulled_in(level):
    positions = np.array(level["positions"])
    positions[np.argmax(np.linalg.norm(positions, axis=1))] *= np.float32(0.9)
    return {**level, "positions": positions}


def too_sure(level):
    return {**level, "bound": np.asarray(level["bound"]) * 0.9}


@pytest.mark.parametrize("tamper", [pulled_in, too_sure])
def test_a_level_that_fails_verification_takes_levels_from_the_mesh_and_nothing_else(queue, mesh_id, tamper):
    level = stored(queue, mesh_id, artifacts.LEVELS[1])
    stage_jobs.publish(queue.store, mesh_id, "levels", Result(artifacts=[(artifacts.LEVELS[1], tamper(level))]))
    assert run_and_record(queue, mesh_id, "verify").outcome == "done"
    queue.advance(mesh_id)
    manifest = records.read_manifest(queue.store, mesh_id)
    assert manifest.capabilities["clip"].available and manifest.capabilities["inner"].available
    assert not manifest.capabilities["levels"].available
    assert "checks" in manifest.capabilities["levels"].reason
    assert {level.side for level in manifest.hull.levels} == {"inner"}


def test_an_inner_hull_that_fails_verification_takes_only_inner_hulls(queue, mesh_id):
    sequence = stored(queue, mesh_id, artifacts.INNER_SEQUENCE)
    grown = {**sequence, "step_positions": np.asarray(sequence["step_positions"]) * np.float32(1.5)}
    stage_jobs.publish(queue.store, mesh_id, "inner", Result(artifacts=[(artifacts.INNER_SEQUENCE, grown)]))
    run_and_record(queue, mesh_id, "verify")
    queue.advance(mesh_id)
    manifest = records.read_manifest(queue.store, mesh_id)
    assert manifest.capabilities["clip"].available
    assert not manifest.capabilities["inner"].available
    assert not any(level.side == "inner" for level in manifest.hull.levels)


def test_the_manifest_lists_measured_hulls_of_both_sides_in_model_units(queue, mesh_id):
    assert run_and_record(queue, mesh_id, "verify").outcome == "done"
    queue.advance(mesh_id)
    manifest = records.read_manifest(queue.store, mesh_id)
    outer, inner = ([level for level in manifest.hull.levels if level.side == side] for side in ("outer", "inner"))
    assert [level.faces for level in outer] == sorted((level.faces for level in outer), reverse=True)
    assert outer[-1].faces == manifest.hull.faces
    assert all(level.volume_excess > 0.0 for level in outer) and all(level.volume_excess < 0.0 for level in inner)
    assert [level.distance for level in outer] == sorted(level.distance for level in outer)
    for level, layout in zip(outer, artifacts.LEVELS, strict=False):
        kept = stored(queue, mesh_id, layout)
        assert len(kept["faces"]) == level.faces
        assert level.distance == pytest.approx(kept["bound"][0] * manifest.frame.scale)
    assert 0.01 < outer[-1].distance < 50.0
