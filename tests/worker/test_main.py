import os
import subprocess
import sys
from pathlib import Path

from geometry.topology import build_edges, signed_volume
from worker.warm import ellipsoid, warm_kernels

ROOT = Path(__file__).resolve().parents[2]


def test_a_worker_without_a_queue_says_what_is_missing(tmp_path):
    environment = {name: value for name, value in os.environ.items() if not name.startswith("SILHOUETTE_")}
    environment["SILHOUETTE_DATA_DIR"] = str(tmp_path)
    done = subprocess.run(
        [sys.executable, "-m", "worker"], cwd=ROOT, env=environment, capture_output=True, text=True, check=False, timeout=60
    )
    assert done.returncode == 2
    assert "SILHOUETTE_REDIS_URL" in done.stderr
    assert "Traceback" not in done.stderr


def test_the_mesh_that_warms_the_kernels_is_closed_and_outward():
    positions, faces = ellipsoid()
    assert len(build_edges(faces).vertices) == 3 * len(faces) // 2
    assert signed_volume(positions, faces) > 0.0


def test_warming_runs_every_stage():
    warm_kernels()
