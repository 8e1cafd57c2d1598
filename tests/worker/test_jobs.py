import os
import shutil
import signal
import threading
import time
from pathlib import Path

import numpy as np
import pytest
import redis
import trimesh
from rq.serializers import JSONSerializer
from rq.timeouts import JobTimeoutException

from backend import records
from backend.artifacts import open_artifact
from backend.damage import is_sound
from backend.local_store import LocalStore
from backend.queue import JobQueue
from backend.settings import BackendSettings
from backend.stage_jobs import StageQueue, started_entries
from schemas import artifacts, keys
from schemas.errors import CancelledError, MeshRejectedError
from schemas.jobs import STAGES
from service.embedded import EmbeddedBackend
from tests.backend.accepting import accept
from tests.meshes import bumpy_sphere, sphere
from worker import jobs as stage_jobs
from worker import stages
from worker.jobs import fault_of, run_and_record
from worker.process import StageWorker
from worker.settings import WorkerSettings
from worker.stages import Result

UNCHECKED = [stage for stage in STAGES if stage != "verify"]
SMALL = {"hull_faces": 60, "texels": 64}
ENVIRONMENT = {
    "SILHOUETTE_WARM_KERNELS": "false",
    "SILHOUETTE_MEASURE": "false",
    "SILHOUETTE_LOG_LEVEL": "WARNING",
    "SILHOUETTE_RECONCILE_INTERVAL_S": "1",
}


def ply(mesh):
    return trimesh.Trimesh(*mesh, process=False).export(file_type="ply")


def opened_box():
    """Five sides of a cube: its one hole has four edges, but repair is off."""
    box = trimesh.creation.box()
    return ply((box.vertices, box.faces[2:]))


def start(folder, workers):
    backend = EmbeddedBackend(folder, workers, ENVIRONMENT)
    backend.start()
    return backend, JobQueue.open(BackendSettings(data_dir=folder, redis_url=backend.redis_url))


@pytest.fixture(scope="module")
def running(tmp_path_factory):
    """(backend, queue): a real server and two real worker processes."""
    backend, queue = start(tmp_path_factory.mktemp("data"), 2)
    yield backend, queue
    backend.stop()


def wait_for(condition, timeout_s=120.0):
    deadline = time.monotonic() + timeout_s
    while time.monotonic() < deadline:
        if result := condition():
            return result
        time.sleep(0.02)
    raise AssertionError("it did not happen in time")


def finished(queue, mesh_id, timeout_s=120.0):
    return wait_for(lambda: records.read_manifest(queue.store, mesh_id), timeout_s)


def process(queue, data, **options):
    mesh_id = accept(queue.store, data, name="mesh.ply", **options)
    queue.advance(mesh_id)
    return mesh_id, finished(queue, mesh_id)


def files_of(store, mesh_id):
    return {key.rpartition("/")[2] for key in store.list(f"{keys.MESHES}{mesh_id}/")}


# Through real worker processes.


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
    mesh_id, manifest = process(queue, ply(sphere(1)), **SMALL)
    again, second = process(queue, ply(sphere(1)), **SMALL)
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
    meshes = [accept(queue.store, ply(sphere(1, radius=1 + n)), name="a.ply", **SMALL) for n in range(4)]
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


# One stage at a time, in this process.


@pytest.fixture
def queue(running, tmp_path):
    """A queue over its own store: nobody but the test works on it."""
    return JobQueue(running[1].redis, LocalStore(tmp_path / "store"))


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


def test_two_workers_that_race_through_a_mesh_publish_one_result(running, queue, tmp_path, monkeypatch):
    monkeypatch.setenv("SILHOUETTE_DATA_DIR", str(tmp_path))
    monkeypatch.setenv("SILHOUETTE_REDIS_URL", running[0].redis_url)
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


def test_a_mesh_deleted_just_after_its_stage_published_leaves_no_progress(queue, running, tmp_path, monkeypatch):
    mesh_id = accept(queue.store, ply(sphere(1)), name="a.ply", **SMALL)

    def then_deleted(jobs, mesh_id, stage):
        run_and_record(jobs, mesh_id, stage)
        queue.cancel(mesh_id)

    monkeypatch.setenv("SILHOUETTE_DATA_DIR", str(tmp_path))
    monkeypatch.setenv("SILHOUETTE_REDIS_URL", running[0].redis_url)
    monkeypatch.setattr(stage_jobs, "run_and_record", then_deleted)
    stage_jobs.run_stage(mesh_id, "load")
    assert list(queue.store.list()) == []
    assert queue.progress.read(mesh_id) == {}


def test_a_heartbeat_just_after_a_job_has_ended_leaves_nothing_of_it(running):
    queue = JobQueue(running[1].redis, running[1].store)
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


def test_an_artifact_that_fails_verification_takes_clipping_from_the_mesh(queue):
    mesh_id = accept(queue.store, ply(sphere(2)), name="a.ply", **SMALL)
    for stage in UNCHECKED:
        run_and_record(queue, mesh_id, stage)
    hull = open_artifact(queue.store.local_path(keys.artifact(mesh_id, artifacts.HULL.file)), artifacts.HULL)
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
def test_a_mesh_that_fails_verification_itself_fails(queue, name):
    mesh_id = accept(queue.store, ply(bumpy_sphere(4)), name="a.ply", hull_faces=200, texels=64)
    for stage in UNCHECKED:
        run_and_record(queue, mesh_id, stage)
    mesh = open_artifact(queue.store.local_path(keys.artifact(mesh_id, artifacts.MESH.file)), artifacts.MESH)
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
def test_a_level_that_fails_verification_takes_levels_from_the_mesh_and_nothing_else(queue, tamper):
    mesh_id = accept(queue.store, ply(bumpy_sphere(4)), name="a.ply", hull_faces=200, texels=64)
    for stage in UNCHECKED:
        run_and_record(queue, mesh_id, stage)
    level = open_artifact(queue.store.local_path(keys.artifact(mesh_id, artifacts.LEVELS[1].file)), artifacts.LEVELS[1])
    stage_jobs.publish(queue.store, mesh_id, "levels", Result(artifacts=[(artifacts.LEVELS[1], tamper(level))]))
    assert run_and_record(queue, mesh_id, "verify").outcome == "done"
    queue.advance(mesh_id)
    manifest = records.read_manifest(queue.store, mesh_id)
    assert manifest.capabilities["clip"].available and manifest.capabilities["inner"].available
    assert not manifest.capabilities["levels"].available
    assert "checks" in manifest.capabilities["levels"].reason
    assert {level.side for level in manifest.hull.levels} == {"inner"}


def test_an_inner_hull_that_fails_verification_takes_only_inner_hulls(queue):
    mesh_id = accept(queue.store, ply(bumpy_sphere(3)), name="a.ply", **SMALL)
    for stage in UNCHECKED:
        run_and_record(queue, mesh_id, stage)
    sequence = open_artifact(queue.store.local_path(keys.artifact(mesh_id, artifacts.INNER_SEQUENCE.file)), artifacts.INNER_SEQUENCE)
    grown = {**sequence, "step_positions": np.asarray(sequence["step_positions"]) * np.float32(1.5)}
    stage_jobs.publish(queue.store, mesh_id, "inner", Result(artifacts=[(artifacts.INNER_SEQUENCE, grown)]))
    run_and_record(queue, mesh_id, "verify")
    queue.advance(mesh_id)
    manifest = records.read_manifest(queue.store, mesh_id)
    assert manifest.capabilities["clip"].available
    assert not manifest.capabilities["inner"].available
    assert not any(level.side == "inner" for level in manifest.hull.levels)


def test_the_manifest_lists_measured_hulls_of_both_sides_in_model_units(queue):
    mesh_id = accept(queue.store, ply(tuple(scaled(bumpy_sphere(4), 50.0))), name="a.ply", hull_faces=200, texels=64)
    for stage in STAGES:
        assert run_and_record(queue, mesh_id, stage).outcome == "done"
    queue.advance(mesh_id)
    manifest = records.read_manifest(queue.store, mesh_id)
    outer, inner = ([level for level in manifest.hull.levels if level.side == side] for side in ("outer", "inner"))
    assert [level.faces for level in outer] == sorted((level.faces for level in outer), reverse=True)
    assert outer[-1].faces == manifest.hull.faces
    assert all(level.volume_excess > 0.0 for level in outer) and all(level.volume_excess < 0.0 for level in inner)
    assert [level.distance for level in outer] == sorted(level.distance for level in outer)
    for level, layout in zip(outer, artifacts.LEVELS, strict=False):
        stored = open_artifact(queue.store.local_path(keys.artifact(mesh_id, layout.file)), layout)
        assert len(stored["faces"]) == level.faces
        assert level.distance == pytest.approx(stored["bound"][0] * manifest.frame.scale)
    assert 0.01 < outer[-1].distance < 50.0


def scaled(mesh, factor):
    return mesh[0] * factor, mesh[1]


# Faults on purpose.


def large():
    return ply(bumpy_sphere(6))


def stage_runs(queue, mesh_id, stage):
    """Whether the stage has started, is some way in, and has not ended."""
    return queue.progress.read(mesh_id).get(stage, 0.0) > 0.0 and records.read_stage(queue.store, mesh_id, stage) is None


def answers(queue):
    try:
        return queue.redis.ping()
    except redis.RedisError:
        return False


def keep(backend, queue):
    """What the server had is there when it starts again."""


def forget(backend, queue):
    queue.redis.flushall()


def remove(backend, queue):
    shutil.rmtree(backend.data_dir / "redis")


@pytest.mark.heavy
@pytest.mark.parametrize("data", [keep, forget, remove])
def test_a_killed_queue_server_loses_no_accepted_mesh(tmp_path, data):
    backend, queue = start(tmp_path, 2)
    try:
        meshes = [accept(queue.store, ply(sphere(1, radius=1 + n)), name="a.ply", **SMALL) for n in range(6)]
        unusable = accept(queue.store, b"ply\nthis is not one", name="a.ply")
        for mesh_id in (*meshes, unusable):
            queue.advance(mesh_id)
        for _ in range(2):
            time.sleep(0.7)
            wait_for(lambda: answers(queue))
            server = backend.pids()["valkey"]
            data(backend, queue)
            os.kill(server, signal.SIGKILL)
            wait_for(lambda server=server: backend.pids().get("valkey", server) != server)
        late = accept(queue.store, ply(sphere(1, radius=0.5)), name="a.ply", **SMALL)
        assert {finished(queue, mesh_id).status for mesh_id in (*meshes, late)} == {"ready"}
        assert finished(queue, unusable).status == "failed"
        assert all(keys.MANIFEST in found for _, found in records.outlines(queue.store))
    finally:
        backend.stop()


def left_of(queue, mesh_id):
    """Keys of a deleted mesh, once the jobs that were enqueued meanwhile have found it gone; RQ's records of ended jobs may stay."""
    for _ in range(200):
        left = [key for key in queue.redis.scan_iter(f"*{mesh_id}*") if b":results:" not in key and b":job:" not in key]
        if not left:
            break
        time.sleep(0.02)
    return left


@pytest.mark.heavy
@pytest.mark.parametrize("stage", STAGES)
def test_deleting_during_a_stage_leaves_nothing(running, stage):
    _, queue = running
    before = set(queue.store.list(keys.MESHES)) | set(queue.store.list(keys.UPLOADS))
    data, texels = (ply(bumpy_sphere(4)), 64) if stage == "verify" else (large(), 4096)
    mesh_id = accept(queue.store, data, name="a.ply", texels=texels)
    queue.advance(mesh_id)
    wait_for(lambda: stage in queue.progress.read(mesh_id) or records.read_manifest(queue.store, mesh_id))
    assert queue.cancel(mesh_id)
    wait_for(lambda: not any(map(started_entries, (queue.queue, queue.later))))
    assert set(queue.store.list(keys.MESHES)) | set(queue.store.list(keys.UPLOADS)) == before
    assert not [key for key in queue.store.list() if mesh_id in key]
    assert list((queue.store.root / ".tmp").iterdir()) == []
    assert left_of(queue, mesh_id) == []


@pytest.mark.heavy
def test_stopping_is_quick_during_a_stage_and_the_next_start_goes_on(tmp_path):
    backend, queue = start(tmp_path, 1)
    mesh_id = accept(queue.store, large(), name="a.ply", texels=256)
    queue.advance(mesh_id)
    wait_for(lambda: stage_runs(queue, mesh_id, "hull"))
    started = time.monotonic()
    backend.stop(grace_s=0.5)
    assert time.monotonic() - started < 5.0
    backend, queue = start(tmp_path, 1)
    try:
        wait_for(lambda: "hull" in queue.progress.read(mesh_id), 10.0)
        assert finished(queue, mesh_id).status == "ready"
    finally:
        backend.stop()


def children_of(pid):
    return [int(word) for word in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]


def is_job(pid):
    """Whether a child of a worker runs a job: RQ gives those a process group of their own, and what a worker does beside has none."""
    try:
        return os.getpgid(pid) == pid
    except ProcessLookupError:
        return False


@pytest.mark.heavy
def test_a_stage_whose_process_always_dies_fails_the_mesh_and_not_the_worker(tmp_path):
    backend, queue = start(tmp_path, 1)
    try:
        wait_for(lambda: "worker-1" in backend.pids())
        worker = backend.pids()["worker-1"]
        mesh_id = accept(queue.store, large(), name="a.ply", texels=256)
        queue.advance(mesh_id)
        killed = set()

        def kill_all_or_ended():
            for pid in set(children_of(worker)) - killed:
                if is_job(pid):
                    os.kill(pid, signal.SIGKILL)
                    killed.add(pid)
            return records.read_manifest(queue.store, mesh_id)

        manifest = wait_for(kill_all_or_ended)
        assert len(killed) == 4
        assert manifest.status == "failed"
        assert manifest.error.model_extra["code"] == "stage-failed"
        assert backend.pids()["worker-1"] == worker
    finally:
        backend.stop()
