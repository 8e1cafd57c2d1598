"""The later stages through real worker processes, with a measurement of the tests' own."""

import os
import signal
import time

import pytest

from backend import records
from backend.stage_jobs import started_entries
from schemas import jobs as names
from schemas import keys
from schemas.jobs import LATER_STAGES, STAGES
from tests.backend.accepting import accept, of_meshes
from tests.meshes import sphere
from tests.worker.forks import forked_workers, private_queue
from tests.worker.measuring import STEPS
from tests.worker.processing import SMALL, files_of, left_of, opened_box, ply, wait_for
from worker import jobs as stage_jobs
from worker.process import LOWEST_PRIORITY


@pytest.fixture
def queue(tmp_path, monkeypatch, compiled):
    """The queue of a private server without workers, with settings for those that are forked, and their measurement."""
    with private_queue(tmp_path, monkeypatch, STAGE_ATTEMPTS=2) as queue:
        yield queue


@pytest.fixture
def workers(queue):
    """Starts worker processes."""
    with forked_workers() as start:
        yield start


def upload(queue, mesh, **options):
    mesh_id = accept(queue.store, mesh, name="mesh.ply", **(SMALL | options))
    queue.advance(mesh_id)
    return mesh_id


def record_of(queue, mesh_id, stage):
    return records.read_stage(queue.store, mesh_id, stage)


def measured(queue, mesh_id):
    return wait_for(lambda: record_of(queue, mesh_id, "measure"), 240.0)


def test_a_ready_mesh_is_measured_by_a_process_of_lowest_priority(queue, workers):
    workers(1)
    mesh_id = upload(queue, ply(sphere(2)))
    record = measured(queue, mesh_id)
    assert (record.outcome, record.error) == ("done", None)
    assert record.report == {"faces": 320, "steps": STEPS, "nice": LOWEST_PRIORITY}
    manifest = records.read_manifest(queue.store, mesh_id)
    assert manifest.status == "ready"
    assert [r.stage for r in manifest.stages] == list(STAGES)
    wait_for(lambda: not queue.store.exists(keys.partial(mesh_id, "measure")))
    wait_for(lambda: not queue.progress.read(mesh_id))


def test_a_mesh_that_cannot_be_clipped_is_measured_without_other_hulls(queue, workers):
    workers(1)
    mesh_id = upload(queue, opened_box(), repair="never")
    assert measured(queue, mesh_id).report["faces"] == 10
    assert record_of(queue, mesh_id, "hulls").outcome == "skipped"


@pytest.mark.parametrize("count", [1, pytest.param(2, marks=pytest.mark.heavy)])
def test_measuring_lets_other_meshes_become_ready_first_and_goes_on_where_it_was(queue, workers, count):
    workers(count)
    first = upload(queue, ply(sphere(2)))
    wait_for(lambda: queue.progress.read(first).get("measure", 0.0) > 0.1, 240.0)
    others = [upload(queue, ply(sphere(1, radius=1.0 + n))) for n in range(2)]
    ready = [wait_for(lambda m=m: records.read_manifest(queue.store, m), 240.0) for m in others]
    assert {manifest.status for manifest in ready} == {"ready"}
    if count == 1:
        assert record_of(queue, first, "measure") is None, "it waits until all others are ready"
    assert measured(queue, first).outcome == "done"
    for mesh_id in others:
        assert measured(queue, mesh_id).outcome == "done"
    if count == 1:
        assert record_of(queue, first, "measure").report["steps"] < STEPS, "what it had is kept"


@pytest.mark.heavy
def test_a_worker_killed_while_measuring_loses_nothing(queue, workers):
    (pid,) = workers(1)
    mesh_id = upload(queue, ply(sphere(1)))
    wait_for(lambda: queue.progress.read(mesh_id).get("measure", 0.0) > 0.1, 240.0)
    os.kill(pid, signal.SIGKILL)
    killed = time.monotonic()
    workers(1)
    assert measured(queue, mesh_id).report["steps"] < STEPS
    assert time.monotonic() - killed < 45.0
    assert records.read_manifest(queue.store, mesh_id).status == "ready"


def test_a_measurement_that_breaks_fails_its_stage_and_the_mesh_stays_ready(queue, workers, monkeypatch):
    monkeypatch.setattr(names, "MEASURE", "tests.worker.measuring.measure_nothing")
    workers(1)
    mesh_id = upload(queue, ply(sphere(1)))
    record = measured(queue, mesh_id)
    assert (record.outcome, record.error.model_extra["code"]) == ("failed", "stage-failed")
    assert records.read_manifest(queue.store, mesh_id).status == "ready"
    assert queue.reconcile() == 0


def test_a_redis_that_forgets_during_later_stages_gets_them_back(queue, workers):
    workers(1)
    mesh_id = upload(queue, ply(sphere(1)))
    wait_for(lambda: records.read_manifest(queue.store, mesh_id), 240.0)
    queue.redis.flushall()
    assert measured(queue, mesh_id).outcome == "done"


@pytest.mark.parametrize("stage", LATER_STAGES)
def test_deleting_during_a_later_stage_leaves_nothing(queue, workers, stage):
    workers(1)
    mesh_id = upload(queue, ply(sphere(3)))
    wait_for(lambda: stage in queue.progress.read(mesh_id), 240.0)
    assert queue.cancel(mesh_id)
    wait_for(lambda: not any(map(started_entries, (queue.queue, queue.later))))
    assert of_meshes(queue.store) == []
    assert left_of(queue, mesh_id) == []


def test_a_stage_of_a_mesh_that_was_accepted_anew_meanwhile_is_not_published(queue, monkeypatch):
    mesh_id = accept(queue.store, ply(sphere(1)), name="mesh.ply", **SMALL)
    for stage in STAGES:
        stage_jobs.run_and_record(queue, mesh_id, stage)
    queue.advance(mesh_id)

    def replaced(inputs):
        queue.cancel(mesh_id)
        accept(queue.store, ply(sphere(1)), name="mesh.ply", **SMALL)
        return stage_jobs.stages.SKIPPED

    monkeypatch.setitem(stage_jobs.STAGE_FUNCTIONS, "hulls", replaced)
    with pytest.raises(stage_jobs.CancelledError):
        stage_jobs.run_and_record(queue, mesh_id, "hulls")
    assert files_of(queue.store, mesh_id) == {"accepted.json"}


def test_jobs_that_are_left_when_measuring_is_turned_off_do_nothing(queue, monkeypatch):
    mesh_id = accept(queue.store, ply(sphere(1)), name="mesh.ply", **SMALL)
    for stage in STAGES:
        stage_jobs.run_and_record(queue, mesh_id, stage)
    queue.advance(mesh_id)
    before = files_of(queue.store, mesh_id)
    monkeypatch.setenv("SILHOUETTE_MEASURE", "false")
    stage_jobs.run_stage(mesh_id, "measure")
    assert files_of(queue.store, mesh_id) == before
