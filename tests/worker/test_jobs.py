"""One stage at a time, in this process: what is published, and what becomes of faults."""

import os
import threading

import pytest
from rq.serializers import JSONSerializer
from rq.timeouts import JobTimeoutException

from backend import records
from backend.artifacts import open_artifact
from backend.damage import is_sound
from backend.stage_jobs import StageQueue
from schemas import artifacts, keys
from schemas.errors import MeshRejectedError
from schemas.jobs import STAGES
from tests.backend.accepting import accept
from tests.meshes import bumpy_sphere, sphere
from tests.worker.processing import SMALL, files_of, finished, ply
from worker import jobs as stage_jobs
from worker.jobs import fault_of, run_and_record
from worker.process import StageWorker
from worker.settings import WorkerSettings


def test_two_workers_that_run_the_same_stage_publish_the_same(queue):
    mesh_id = accept(queue.store, ply(sphere(2)), name="a.ply", **SMALL)
    results = []
    threads = [threading.Thread(target=lambda: results.append(run_and_record(queue, mesh_id, "load"))) for _ in range(2)]
    [thread.start() for thread in threads]
    [thread.join() for thread in threads]
    assert [r.outcome for r in results] == ["done", "done"]
    assert results[0].artifacts == results[1].artifacts
    assert results[0].report == results[1].report
    path = queue.store.local_path(keys.artifact(mesh_id, artifacts.MESH.file))
    open_artifact(path, artifacts.MESH, verify=True)


def test_two_workers_that_race_through_a_mesh_publish_one_result(server, queue, tmp_path, monkeypatch):
    monkeypatch.setenv("SILHOUETTE_DATA_DIR", str(tmp_path))
    monkeypatch.setenv("SILHOUETTE_REDIS_URL", server.redis_url)
    mesh_id = accept(queue.store, ply(sphere(2)), name="a.ply", **SMALL)
    racers = []
    for _ in range(2):
        racers.append(os.fork())
        if racers[-1] == 0:
            try:
                for stage in STAGES:
                    stage_jobs.run_stage(mesh_id, stage)
                os._exit(0)
            finally:
                os._exit(1)
    assert [os.waitpid(racer, 0)[1] for racer in racers] == [0, 0]
    manifest = finished(queue, mesh_id)
    assert manifest.status == "ready" and all(is_sound(queue.store, mesh_id, record) for record in manifest.stages)
    assert manifest.stages == [records.read_stage(queue.store, mesh_id, stage) for stage in STAGES]
    published = {name for record in manifest.stages for name in record.artifacts} | {keys.stage_name(stage) for stage in STAGES}
    expected = {keys.artifact(mesh_id, name) for name in published | {keys.ACCEPTED, keys.MANIFEST}}
    assert set(queue.store.list(keys.MESHES)) == expected
    assert list((queue.store.root / ".tmp").iterdir()) == []


def test_running_a_stage_again_writes_the_same_bytes(queue):
    mesh_id = accept(queue.store, ply(bumpy_sphere(2)), name="a.ply", **SMALL)
    first = {}
    for _ in range(2):
        for stage in STAGES:
            run_and_record(queue, mesh_id, stage)
        found = {key: queue.store.get_bytes(key) for key in queue.store.list(f"meshes/{mesh_id}/") if not key.endswith(".json")}
        first = first or found
        assert found == first


def test_a_heartbeat_just_after_a_job_has_ended_leaves_nothing_of_it(queue):
    queue.queue = StageQueue("of-nobody", connection=queue.redis, serializer=JSONSerializer)
    worker = StageWorker(queue, WorkerSettings())
    worker.register_birth()
    job = queue.queue.enqueue("worker.jobs.run_stage", args=("a" * 32, "load"), job_id="ended-load")
    execution = worker.prepare_execution(job)
    worker.maintain_heartbeats(job, execution)
    assert queue.redis.exists(execution.key)
    with queue.redis.pipeline() as pipe:
        execution.delete(job, pipeline=pipe)
        pipe.execute()
    worker.maintain_heartbeats(job, execution)
    worker.register_death()
    assert [key for key in queue.redis.scan_iter(b"*ended-load*") if b":job:" not in key] == []


@pytest.mark.parametrize(
    ("error", "code"),
    [
        (MeshRejectedError("It has no faces.", code="no-faces", face=3), "no-faces"),
        (MemoryError(), "out-of-memory"),
        (JobTimeoutException("Task exceeded maximum timeout value"), "time-limit"),
    ],
)
def test_faults_that_stay_are_recorded_as_problems(queue, monkeypatch, error, code):
    mesh_id = accept(queue.store)

    def failing(inputs):
        raise error

    monkeypatch.setitem(stage_jobs.STAGE_FUNCTIONS, "load", failing)
    record = run_and_record(queue, mesh_id, "load")
    assert record.outcome == "failed"
    assert record.error.model_extra["code"] == code
    assert record.error.detail == fault_of(error).message
    queue.advance(mesh_id)
    assert records.read_manifest(queue.store, mesh_id).error == record.error


def test_other_errors_are_the_queues_and_leave_no_record(queue, monkeypatch):
    mesh_id = accept(queue.store)
    monkeypatch.setitem(stage_jobs.STAGE_FUNCTIONS, "load", lambda inputs: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        run_and_record(queue, mesh_id, "load")
    assert files_of(queue.store, mesh_id) == {"accepted.json"}
