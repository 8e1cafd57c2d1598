"""A queue with real workers, meshes that are small enough for it, and what to wait for."""

import os
import time
from pathlib import Path

import trimesh

from backend import records
from backend.queue import JobQueue
from backend.settings import BackendSettings
from schemas import keys
from service.embedded import EmbeddedBackend
from tests.backend.accepting import accept

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


def stage_runs(queue, mesh_id, stage):
    """Whether the stage has started, is some way in, and has not ended."""
    return queue.progress.read(mesh_id).get(stage, 0.0) > 0.0 and records.read_stage(queue.store, mesh_id, stage) is None


def left_of(queue, mesh_id):
    """Keys of a deleted mesh, once the jobs that were enqueued meanwhile have found it gone; RQ's records of ended jobs may stay."""
    for _ in range(200):
        left = [key for key in queue.redis.scan_iter(f"*{mesh_id}*") if b":results:" not in key and b":job:" not in key]
        if not left:
            break
        time.sleep(0.02)
    return left


def children_of(pid):
    return [int(word) for word in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]


def is_job(pid):
    """Whether a child of a worker runs a job: RQ gives those a process group of their own, and what a worker does beside has none."""
    try:
        return os.getpgid(pid) == pid
    except ProcessLookupError:
        return False
