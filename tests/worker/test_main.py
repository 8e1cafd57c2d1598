import os
import subprocess
import sys
import time
from pathlib import Path

from backend import once, records
from geometry.topology import build_edges, signed_volume
from tests.backend.accepting import accept
from tests.worker.processing import start, wait_for
from worker.warm import ellipsoid, warm_kernels

ROOT = Path(__file__).resolve().parents[2]


def started(**settings):
    """A worker that ends by itself, with no settings but these."""
    environment = {name: value for name, value in os.environ.items() if not name.startswith("SILHOUETTE_")} | settings
    return subprocess.run(
        [sys.executable, "-m", "worker"], cwd=ROOT, env=environment, capture_output=True, text=True, check=False, timeout=60
    )


def test_a_worker_without_a_queue_says_what_is_missing(tmp_path):
    done = started(SILHOUETTE_DATA_DIR=str(tmp_path))
    assert done.returncode == 2
    assert "SILHOUETTE_REDIS_URL" in done.stderr
    assert "Traceback" not in done.stderr


def test_a_setting_that_cannot_be_used_is_one_line_that_names_it():
    done = started(SILHOUETTE_REDIS_URL="http://somewhere")
    assert done.returncode == 2
    assert done.stderr == "setting redis_url: a Redis is named by redis://, rediss:// or unix://\n"


def test_a_worker_that_starts_sweeps_what_is_old_and_belongs_to_nobody(tmp_path):
    backend, queue = start(tmp_path, 0)
    try:
        kept, root = accept(queue.store), queue.store.root
        unwanted = [
            root / ".tmp/old",
            root / "uploads" / ("f" * 64),
            root / "meshes/a/hull.glb",
            once.store_of(queue.store).root / ".tmp/old",
        ]
        for path in (*unwanted, young := root / ".tmp/young"):
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(b"left by one that was killed")
        for path in unwanted:
            os.utime(path, (time.time() - 7 * 3600,) * 2)
        settings = {"SILHOUETTE_DATA_DIR": str(tmp_path), "SILHOUETTE_REDIS_URL": backend.redis_url, "SILHOUETTE_WARM_KERNELS": "0"}
        command = [sys.executable, "-m", "worker"]
        with subprocess.Popen(command, cwd=ROOT, env={**os.environ, **settings}, stderr=subprocess.DEVNULL) as worker:
            try:
                wait_for(lambda: not any(path.exists() for path in unwanted))
            finally:
                worker.kill()
        assert young.exists() and records.is_accepted(queue.store, kept)
    finally:
        backend.stop()


def test_the_mesh_that_warms_the_kernels_is_closed_and_outward():
    positions, faces = ellipsoid()
    assert len(build_edges(faces).vertices) == 3 * len(faces) // 2
    assert signed_volume(positions, faces) > 0.0


def test_warming_runs_every_stage():
    warm_kernels()
