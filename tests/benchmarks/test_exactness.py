"""A tiny run of each part, and that each would tell."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from benchmarks import exact_eyes, exact_signs
from benchmarks.exactness import bars, main
from client.shapes import write_ply
from tests import degenerate, meshes

pytestmark = pytest.mark.xdist_group("exactness")  # one run of the benchmark for all tests

ROOT = Path(__file__).resolve().parents[2]


def run(*options):
    command = [sys.executable, "-m", "benchmarks.exactness", *options]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True).stdout


@pytest.fixture(scope="module")
def result(tmp_path_factory):
    path = tmp_path_factory.mktemp("meshes") / "knot.ply"
    write_ply(str(path), *meshes.knot())
    return json.loads(run("--json", "--signs", "2600", "--eyes", "180", "--seconds", "0.1", "--meshes", f"{path},absent_mesh"))


def test_no_sign_is_wrong_and_hard_families_take_the_exact_path(result):
    rows = {row["family"]: row for row in result["signs"]}
    assert set(rows) == {family.__name__ for family in degenerate.FAMILIES}
    assert all(row["signs"] == 200 and row["wrong"] == 0 for row in rows.values())
    assert rows["anywhere"]["exact_share"] == 0.0 and rows["few_ulps_off"]["exact_share"] > 0.5


def test_no_silhouette_of_a_hard_mesh_is_wrong(result):
    assert [row["mesh"] for row in result["eyes"]] == list(exact_eyes.SHAPES)
    for row in result["eyes"]:
        assert row["eyes"] == 15 and row["silhouette_edges"] > 0 and not row["faults"]
        assert row["mismatches"] == dict.fromkeys(exact_eyes.WAYS, 0)


def test_the_cost_of_exactness_is_a_ratio_of_two_walks(result):
    (row,) = result["cost"]
    assert row["faces"] == 5120 and row["float_us"] > 0.0 and 0.5 < row["ratio"] < 3.0
    assert 0.0 < row["faces_decided_exactly"] < row["faces_tested"]
    assert result["absent"] == [word for word in result["absent"] if "absent_mesh" in word] and len(result["absent"]) == 1


def test_parts_can_be_left_out_and_the_table_tells_bars(monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", ["exactness", "--signs", "26", "--eyes", "0", "--seconds", "0"])
    main()
    text = capsys.readouterr().out
    assert "met: wrong signs: 0" in text and "silhouette" not in text and "ratio" not in text


def test_a_bar_that_is_missed_is_told():
    result = {"signs": [{"wrong": 1}], "eyes": [{"mismatches": {"tree": 0, "simd": 2}}], "cost": [{"ratio": 1.01}, {"ratio": 1.2}]}
    assert [bar["met"] for bar in bars(result)] == [False, False, False]


def test_a_wrong_sign_is_counted(monkeypatch):
    monkeypatch.setattr(exact_signs.oracles_integer, "orientations", lambda corners, eyes: np.zeros(len(eyes), np.int8))
    count, wrong, _, _ = exact_signs.count_chunk(0, 0, 50)
    assert (count, wrong) == (50, 50)


def test_a_wrong_silhouette_is_counted_with_its_eye(monkeypatch):
    monkeypatch.setattr(exact_eyes, "silhouette_edgewise", lambda *_: np.empty((0, 2), np.int32))
    row = exact_eyes.count_mismatches("torus", 15, 0)
    assert row["mismatches"]["edgewise"] > 0 and row["mismatches"]["tree"] == 0
    assert row["faults"][0][0] == "edgewise" and len(row["faults"][0]) == 5


@pytest.mark.parametrize("name", exact_eyes.SHAPES)
def test_hard_meshes_are_closed(name):
    vertices, faces = exact_eyes.SHAPES[name]()
    ends = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    assert 100 <= len(faces) <= 4000 and len(np.unique(ends, axis=0)) == len(ends)
    assert np.array_equal(np.unique(ends, axis=0), np.unique(ends[:, ::-1], axis=0))
    assert np.isfinite(vertices).all()
