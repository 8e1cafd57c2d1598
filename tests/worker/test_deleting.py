"""Meshes that are deleted while a stage of theirs runs."""

import pytest

from backend.stage_jobs import started_entries
from schemas.errors import CancelledError
from schemas.jobs import STAGES
from tests.backend.accepting import accept, of_meshes
from tests.meshes import bumpy_sphere, sphere
from tests.worker.forks import forked_workers
from tests.worker.processing import SMALL, left_of, ply, wait_for
from worker import jobs as stage_jobs
from worker import stages
from worker.jobs import run_and_record

MOST_DUE = 4
"""Stages of a mesh that can run at once: after `hull`."""


@pytest.fixture
def found_by_workers(server, queue, tmp_path, monkeypatch):
    """The environment in which a process finds this queue and its store."""
    monkeypatch.setenv("SILHOUETTE_DATA_DIR", str(tmp_path))
    monkeypatch.setenv("SILHOUETTE_REDIS_URL", server.redis_url)


def test_a_mesh_deleted_before_its_stage_publishes_leaves_nothing(queue, monkeypatch):
    mesh_id = accept(queue.store, ply(sphere(1)), name="a.ply", **SMALL)

    def deleted_meanwhile(inputs):
        result = stages.load(inputs)
        queue.cancel(mesh_id)
        return result

    monkeypatch.setitem(stage_jobs.STAGE_FUNCTIONS, "load", deleted_meanwhile)
    with pytest.raises(CancelledError):
        run_and_record(queue, mesh_id, "load")
    assert list(queue.store.list()) == []


def test_a_mesh_deleted_just_after_its_stage_published_leaves_no_progress(queue, found_by_workers, monkeypatch):
    mesh_id = accept(queue.store, ply(sphere(1)), name="a.ply", **SMALL)

    def then_deleted(jobs, mesh_id, stage):
        run_and_record(jobs, mesh_id, stage)
        queue.cancel(mesh_id)

    monkeypatch.setattr(stage_jobs, "run_and_record", then_deleted)
    stage_jobs.run_stage(mesh_id, "load")
    assert list(queue.store.list()) == []
    assert queue.progress.read(mesh_id) == {}


def test_a_running_stage_hears_of_the_deletion_at_its_next_progress(queue, monkeypatch):
    mesh_id = accept(queue.store, ply(sphere(1)), name="a.ply", **SMALL)

    def long_stage(inputs):
        inputs.progress(0.5)
        queue.cancel(mesh_id)
        inputs.progress(0.6)
        raise AssertionError("unreachable")

    monkeypatch.setitem(stage_jobs.STAGE_FUNCTIONS, "load", long_stage)
    with pytest.raises(CancelledError):
        run_and_record(queue, mesh_id, "load")
    assert list(queue.store.list()) == []


def before(stage):
    """Stages that this one needs, in their order."""
    found = {name for needed in STAGES[stage] for name in (*before(needed), needed)}
    return [name for name in STAGES if name in found]


@pytest.mark.heavy
@pytest.mark.parametrize("stage", STAGES)
def test_deleting_during_a_stage_leaves_nothing(queue, found_by_workers, compiled, stage):
    mesh, texels = (sphere(3), 4096) if stage == "bake" else (bumpy_sphere(4 if stage == "verify" else 5), 64)
    mesh_id = accept(queue.store, ply(mesh), name="a.ply", hull_faces=60, texels=texels)
    for name in before(stage):
        assert run_and_record(queue, mesh_id, name).outcome == "done"
    queue.progress.clear(mesh_id)
    queue.advance(mesh_id)
    with forked_workers() as start:
        start(MOST_DUE)
        wait_for(lambda: stage in queue.progress.read(mesh_id))
        assert queue.cancel(mesh_id)
        wait_for(lambda: not any(map(started_entries, (queue.queue, queue.later))))
        assert of_meshes(queue.store) == []
        assert list((queue.store.root / ".tmp").iterdir()) == []
        assert left_of(queue, mesh_id) == []
