"""Rendered lines against vector lines, on a small mesh; and that a wrong line would be seen."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np

from benchmarks.line_pixels import BAR, PULLED_PX, compared
from client.shapes import write_ply
from tests import meshes

ROOT = Path(__file__).resolve().parents[2]


def test_every_method_draws_the_visible_silhouette_and_nothing_else(tmp_path):
    write_ply(str(tmp_path / "knot.ply"), *meshes.knot())
    command = [sys.executable, "-m", "benchmarks.line_pixels", str(tmp_path / "knot.ply"), "--views", "3", "--size", "256", "--json"]
    (row,) = json.loads(subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True).stdout)["meshes"]
    for method in ("edge_mesh", "wireframe", "fattened"):
        assert row[method]["explained"] >= BAR and row[method]["found"] >= BAR, method
    assert row["translated"]["explained"] >= BAR and row["translated"]["found"] >= BAR - 1.0


def test_ink_without_a_line_and_a_line_without_ink_are_told():
    line = np.stack([np.arange(0.0, 100.0), np.full(100, 50.0)], axis=1)
    assert compared(line, line) == (100.0, 100.0)
    explained, found = compared(np.concatenate([line[:50], np.add(line[:50], (0.0, 20.0))]), line)
    assert explained == 50.0 and found < 55.0
    assert compared(np.add(line, (0.0, 7.0)), line)[0] == 0.0 and compared(np.add(line, (0.0, 7.0)), line, PULLED_PX)[0] == 100.0
    assert compared(line, np.empty((0, 2))) == (0.0, 0.0) and compared(np.empty((0, 2)), np.empty((0, 2))) == (100.0, 100.0)
