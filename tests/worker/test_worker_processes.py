"""Meshes through real worker processes."""

from pathlib import Path

import pytest

from backend.artifacts import open_artifact
from schemas import artifacts, keys
from schemas.jobs import STAGES
from tests.backend.accepting import accept
from tests.meshes import sphere
from tests.worker.processing import SMALL, files_of, finished, opened_box, ply, process, start, wait_for

pytestmark = pytest.mark.xdist_group("worker processes")


@pytest.fixture(scope="module")
def running(tmp_path_factory):
    """(backend, queue): a real server and two real worker processes."""
    backend, queue = start(tmp_path_factory.mktemp("data"), 2)
    yield backend, queue
    backend.stop()


def test_a_closed_mesh_becomes_ready_with_all_its_artifacts(running):
    _, queue = running
    mesh_id, manifest = process(queue, ply(sphere(2)), **SMALL)
    assert manifest.status == "ready", manifest.error
    assert manifest.capabilities["clip"].available
    assert manifest.stats.faces == 320
    assert manifest.hull.faces <= 60
    assert manifest.hull.volume_excess > 0
    assert manifest.frame.scale == pytest.approx(1.0, rel=1e-6)
    assert [(r.stage, r.outcome) for r in manifest.stages] == [(stage, "done") for stage in STAGES]
    assert all(r.seconds > 0 and r.peak_mib > 10 for r in manifest.stages)
    written = {name for r in manifest.stages for name in r.artifacts}
    downloads = {artifacts.HULL_GLB, artifacts.NORMAL_PNG}
    layouts = (artifacts.MESH, artifacts.FILE_VERTICES, artifacts.HULL, artifacts.HULL_SEQUENCE, artifacts.INNER_SEQUENCE)
    layouts += (artifacts.MAPS, artifacts.TREE)
    assert written == {layout.file for layout in layouts} | downloads
    assert written < files_of(queue.store, mesh_id)
    for layout in layouts:
        open_artifact(queue.store.local_path(keys.artifact(mesh_id, layout.file)), layout, verify=True)


def test_the_same_upload_twice_is_one_mesh_and_no_second_job(running):
    _, queue = running
    mesh_id, manifest = process(queue, ply(sphere(2)), **SMALL)
    again, second = process(queue, ply(sphere(2)), **SMALL)
    assert (again, second) == (mesh_id, manifest)
    assert not any(job_id.startswith(mesh_id) for job_id in queue.queue.get_job_ids())


def test_a_mesh_that_is_not_closed_is_ready_but_not_clippable(running):
    _, queue = running
    mesh_id, manifest = process(queue, opened_box(), repair="never", **SMALL)
    assert manifest.status == "ready", manifest.error
    assert not manifest.capabilities["clip"].available
    assert manifest.capabilities["clip"].reason
    assert {r.stage: r.outcome for r in manifest.stages} == {
        "load": "done",
        "hull": "skipped",
        "bake": "skipped",
        "levels": "skipped",
        "tree": "skipped",
        "inner": "skipped",
        "verify": "done",
    }
    assert manifest.hull is None
    assert artifacts.HULL.file not in files_of(queue.store, mesh_id)


@pytest.mark.parametrize("data", [b"ply\nthis is not one", b"<html></html>", b"\0" * 1000])
def test_bytes_that_are_no_mesh_fail_with_their_problem_and_the_workers_live_on(running, data):
    backend, queue = running
    pids = wait_for(lambda: len(backend.pids()) == 4 and backend.pids())
    mesh_id, manifest = process(queue, data)
    assert manifest.status == "failed"
    assert manifest.error.status == 422
    assert manifest.error.model_extra["code"]
    assert str(queue.store.root) not in manifest.error.model_dump_json()
    assert files_of(queue.store, mesh_id) == {"accepted.json", "load.json", "manifest.json"}
    assert backend.pids() == pids


def test_many_meshes_at_once_all_become_ready(running):
    _, queue = running
    meshes = [accept(queue.store, ply(sphere(1, radius=1 + n)), name="a.ply", **SMALL) for n in range(3)]
    for mesh_id in meshes:
        queue.advance(mesh_id)
    assert {finished(queue, mesh_id).status for mesh_id in meshes} == {"ready"}


def test_a_mesh_accepted_without_redis_is_found_by_the_workers(running):
    _, queue = running
    mesh_id = accept(queue.store, ply(sphere(1, radius=0.3)), name="a.ply", **SMALL)
    assert finished(queue, mesh_id, 60.0).status == "ready"


def test_workers_are_called_workers(running):
    backend, _ = running
    for name, pid in backend.pids().items():
        if name != "valkey":
            assert "worker" in Path(f"/proc/{pid}/cmdline").read_text()
