"""A worker that is told to stop ends what it can in time, and returns the rest."""

import os
import signal
import subprocess
import sys
import time
from contextlib import contextmanager
from pathlib import Path

import pytest
from rq.job import Job
from rq.serializers import JSONSerializer

from backend import records
from backend.counts import queue_depths
from tests.backend.accepting import accept
from tests.meshes import sphere
from tests.worker.forks import forked_workers, held_elsewhere
from tests.worker.processing import ENVIRONMENT, SMALL, finished, ply, stage_runs, start, wait_for
from worker.jobs import run_and_record

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture
def backend(tmp_path):
    """(backend, queue) without a worker."""
    backend, queue = start(tmp_path, 0)
    yield backend, queue
    backend.stop()


@contextmanager
def worker(backend, grace_s):
    """The process of a worker, which is killed at the end if it has not ended."""
    environment = ENVIRONMENT | {
        "SILHOUETTE_DATA_DIR": str(backend.data_dir),
        "SILHOUETTE_REDIS_URL": backend.redis_url,
        "SILHOUETTE_STOP_GRACE_S": str(grace_s),
    }
    command = [sys.executable, "-m", "worker"]
    with subprocess.Popen(command, cwd=ROOT, env={**os.environ, **environment}, stderr=subprocess.DEVNULL) as process:
        try:
            yield process
        finally:
            process.kill()


def loaded(queue):
    """A mesh whose next stage is `hull`. Held elsewhere, it cannot end that."""
    mesh_id = accept(queue.store, ply(sphere(3)), name="a.ply", **SMALL)
    assert run_and_record(queue, mesh_id, "load").outcome == "done"
    queue.progress.clear(mesh_id)
    queue.advance(mesh_id)
    return mesh_id


def running(queue):
    return queue_depths(queue.redis, queue)["silhouette"].running


@pytest.mark.heavy
def test_a_stage_that_outlasts_the_grace_is_returned_at_once_with_no_attempt_less(backend, monkeypatch, compiled):
    backend, queue = backend
    mesh_id = loaded(queue)
    with held_elsewhere(queue.store, [mesh_id]), worker(backend, 0.3) as first:
        wait_for(lambda: stage_runs(queue, mesh_id, "hull"))
        attempts = Job.fetch(f"{mesh_id}-hull", connection=queue.redis, serializer=JSONSerializer).retries_left
        asked = time.monotonic()
        first.send_signal(signal.SIGTERM)
        assert first.wait(20.0) == 0
        took = time.monotonic() - asked
    assert took < 6.0
    assert queue.queue.get_job_ids()[0] == f"{mesh_id}-hull"
    assert running(queue) == 0
    assert Job.fetch(f"{mesh_id}-hull", connection=queue.redis, serializer=JSONSerializer).retries_left == attempts
    queue.progress.clear(mesh_id)
    monkeypatch.setenv("SILHOUETTE_DATA_DIR", str(backend.data_dir))
    monkeypatch.setenv("SILHOUETTE_REDIS_URL", backend.redis_url)
    with held_elsewhere(queue.store, [mesh_id]), forked_workers() as start_workers:
        started = time.monotonic()
        start_workers(1)
        wait_for(lambda: stage_runs(queue, mesh_id, "hull"), 60.0)
        assert time.monotonic() - started < 14.0, "not after a heartbeat that is missed"


def test_a_stage_that_ends_within_the_grace_is_not_done_again(backend):
    backend, queue = backend
    mesh_id = accept(queue.store, ply(sphere(3)), name="a.ply", **SMALL)
    queue.advance(mesh_id)
    with worker(backend, 60.0) as only:
        wait_for(lambda: queue.progress.read(mesh_id))
        only.send_signal(signal.SIGTERM)
        assert only.wait(90.0) == 0
    assert records.read_stage(queue.store, mesh_id, "load").outcome == "done"
    assert running(queue) == 0
    assert f"{mesh_id}-load" not in queue.queue.get_job_ids()


def test_a_second_signal_does_not_wait_for_the_grace_and_returns_the_job_too(backend):
    backend, queue = backend
    mesh_id = loaded(queue)
    with held_elsewhere(queue.store, [mesh_id]), worker(backend, 300.0) as only:
        wait_for(lambda: running(queue) and queue.progress.read(mesh_id))
        only.send_signal(signal.SIGTERM)
        time.sleep(0.2)
        only.send_signal(signal.SIGTERM)
        assert only.wait(20.0) == 0
    assert running(queue) == 0
    assert queue.queue.get_job_ids()
    assert all(job_id.startswith(mesh_id) for job_id in queue.queue.get_job_ids())


def test_an_idle_worker_stops_at_once(backend):
    backend, queue = backend
    with worker(backend, 300.0) as only:
        wait_for(lambda: queue.redis.scard("rq:workers"))
        time.sleep(1.0)
        asked = time.monotonic()
        only.send_signal(signal.SIGTERM)
        assert only.wait(20.0) == 0
        assert time.monotonic() - asked < 5.0


@pytest.mark.heavy
def test_stopping_is_quick_during_a_stage_and_the_next_start_goes_on(tmp_path):
    backend, queue = start(tmp_path, 1)
    mesh_id = loaded(queue)
    with held_elsewhere(queue.store, [mesh_id]):
        wait_for(lambda: stage_runs(queue, mesh_id, "hull"))
        started = time.monotonic()
        backend.stop(grace_s=0.5)
        assert time.monotonic() - started < 5.0
    assert records.read_stage(queue.store, mesh_id, "hull") is None
    backend, queue = start(tmp_path, 1)
    try:
        wait_for(lambda: "hull" in queue.progress.read(mesh_id), 10.0)
        assert finished(queue, mesh_id).status == "ready"
    finally:
        backend.stop()
