"""A queue server that is killed while meshes are on their way."""

import os
import shutil
import signal

import pytest
import redis

from backend import records
from backend.queue import JobQueue
from backend.settings import BackendSettings
from schemas import keys
from tests.backend.accepting import accept
from tests.meshes import sphere
from tests.worker.forks import forked_workers, keep_working, private_server
from tests.worker.processing import SMALL, finished, ply, wait_for


def answers(queue):
    try:
        return queue.redis.ping()
    except redis.RedisError:
        return False


def published(queue):
    """How many files meshes have."""
    return sum(1 for _ in queue.store.list(keys.MESHES))


def keep(backend, queue):
    """What the server had is there when it starts again."""


def forget(backend, queue):
    queue.redis.flushall()


def remove(backend, queue):
    shutil.rmtree(backend.data_dir / "redis")


@pytest.mark.heavy
@pytest.mark.parametrize("data", [keep, forget, remove])
def test_a_killed_queue_server_loses_no_accepted_mesh(tmp_path, monkeypatch, compiled, data):
    with private_server(tmp_path, monkeypatch, MEASURE="false") as backend, forked_workers(keep_working) as start:
        queue = JobQueue.open(BackendSettings())
        start(2)
        meshes = [accept(queue.store, ply(sphere(1, radius=1 + n)), name="a.ply", **SMALL) for n in range(6)]
        unusable = accept(queue.store, b"ply\nthis is not one", name="a.ply")
        for mesh_id in (*meshes, unusable):
            queue.advance(mesh_id)
        for _ in range(2):
            before = published(queue)
            wait_for(lambda before=before: published(queue) > before and answers(queue))
            server = backend.pids()["valkey"]
            data(backend, queue)
            os.kill(server, signal.SIGKILL)
            wait_for(lambda server=server: backend.pids().get("valkey", server) != server)
        late = accept(queue.store, ply(sphere(1, radius=0.5)), name="a.ply", **SMALL)
        assert {finished(queue, mesh_id).status for mesh_id in (*meshes, late)} == {"ready"}
        assert finished(queue, unusable).status == "failed"
        assert all(keys.MANIFEST in found for _, found in records.outlines(queue.store))
