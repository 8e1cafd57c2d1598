"""A folder goes through the whole pipeline; and what is measured of a mesh tells a wrong one from a right one."""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks import corpus
from benchmarks.corpus import Pipeline, bars, mesh_files, outcome_of, row_of
from benchmarks.corpus_views import EYE_KINDS, alpha_error, cameras_of, enclosure, silhouettes
from benchmarks.frame import prepare
from client.shapes import write_ply
from schemas.manifest import Manifest, StageRecord
from schemas.mesh import PreprocessOptions, Problem
from service.silhouette.extract import SilhouetteTree
from tests import meshes
from worker.tree import build_tree

pytestmark = pytest.mark.xdist_group("corpus")  # one run of the benchmark for all tests

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    place = tmp_path_factory.mktemp("corpus")
    (place / "inner").mkdir()
    write_ply(str(place / "inner" / "good.ply"), *meshes.bumpy_sphere(2))
    vertices, faces = meshes.torus(48, 24)
    write_ply(str(place / "open.ply"), vertices, faces[: len(faces) // 2])
    (place / "garbage.STL").write_bytes(b"solid of nothing that makes sense" * 9)
    (place / "notes.tsv").write_text("no mesh")
    return place


@pytest.fixture(scope="module")
def rows(folder):
    command = [sys.executable, "-m", "benchmarks.corpus", str(folder), "--views", "12", "--size", "64", "--json"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
    result = json.loads(done.stdout)
    assert all(bar["met"] for bar in result["bars"])
    return {row["file"]: row for row in result["meshes"]}


def test_every_mesh_file_has_its_outcome_and_nothing_else_is_uploaded(rows):
    outcomes = {name: row["outcome"] for name, row in rows.items()}
    assert outcomes == {"inner/good.ply": "ready", "open.ply": "ready", "garbage.STL": "refused"}


def test_a_closed_mesh_is_held_against_every_reference(rows):
    good = rows["inner/good.ply"]
    assert good["reason"] is None and good["closed"] and good["hull_faces"] == 320
    assert good["eyes"] > 12 and good["mismatches"] == good["unbalanced"] == good["bad_pictures"] == good["wrong_pixels"] == 0
    assert 0.0 < good["largest_error"] < 0.1
    assert good["enclosed"] is True and good["refused_views"] == []
    assert 0.0 < good["mask_error"] <= good["mask_error_worst"] < 0.02
    assert 15.0 < good["psnr_db_worst"] <= good["psnr_db"] < 60.0
    assert good["seconds"] > 0.0 and good["peak_mib"] > 10.0


def test_an_open_mesh_is_drawn_from_its_original_and_says_why(rows):
    row = rows["open.ply"]
    assert "not closed" in row["reason"]
    assert row["mismatches"] is row["enclosed"] is row["mask_error"] is None
    assert 0.0 < row["original_error"] < 0.15 and row["bad_pictures"] == 0


def test_garbage_is_refused_with_a_sentence(rows):
    assert rows["garbage.STL"]["reason"].endswith(".")


def test_meshes_are_chosen_by_name_and_come_small_ones_first(folder):
    assert [path.name for path in mesh_files(folder, [], [])] == ["garbage.STL", "good.ply", "open.ply"]
    assert [path.name for path in mesh_files(folder, ["good", "open.ply"], ["open"])] == ["good.ply"]
    with pytest.raises(SystemExit, match="absent"):
        mesh_files(folder, ["absent"], [])


def test_a_mesh_that_takes_too_long_fails_and_the_next_one_is_done(folder, tmp_path, monkeypatch):
    with Pipeline(tmp_path / "data", workers=1) as pipeline:
        with monkeypatch.context() as patch:
            patch.setattr(corpus, "LEAST_LIMIT_S", 0.0)
            row = row_of(pipeline, folder / "inner" / "good.ply", 1, 32, 0.0)
        assert row == {"outcome": "failed", "reason": "preprocessing: not done after 0 s"}
        assert row_of(pipeline, folder / "garbage.STL", 1, 32, 0.0)["outcome"] == "refused"


def ended(stage, code):
    problem = Problem.model_validate({"title": "no", "status": 422, "detail": "No.", "code": code})
    before = [] if stage == "load" else [StageRecord(stage="load", outcome="done", seconds=1.0)]
    record = StageRecord(stage=stage, outcome="failed", seconds=1.0, error=problem)
    return Manifest(id="0" * 32, status="failed", error=problem, stages=[*before, record])


def test_only_a_loader_that_knows_what_is_wrong_refuses():
    assert outcome_of(ended("load", "not-a-mesh")) == "refused"
    assert outcome_of(ended("load", "parser-crashed")) == "failed"
    assert outcome_of(ended("load", "stage-failed")) == "failed"
    assert outcome_of(ended("hull", "out-of-memory")) == "failed"


@pytest.mark.parametrize(
    ("fault", "name"),
    [
        ({"outcome": "failed"}, "meshes without a right result or a clear refusal"),
        ({"outcome": "refused", "reason": None}, "refusals without a reason"),
        ({"enclosed": False}, "hulls that do not enclose"),
        ({"mismatches": 1}, "eyes with another silhouette"),
        ({"unbalanced": 1}, "eyes with open contours"),
        ({"bad_pictures": 1}, "bad pictures"),
        ({"wrong_pixels": 1}, "wrong pixels"),
        ({"refused_views": ["no"]}, "views refused"),
        ({"mask_error": 0.0081}, "mask error, worst mesh"),
    ],
)
def test_each_fault_misses_its_bar(fault, name):
    row = {"outcome": "ready", "reason": None, "mask_error": 0.001}
    assert all(bar["met"] for bar in bars([row]))
    assert [bar["name"] for bar in bars([row, row | fault]) if not bar["met"]] == [name]


@pytest.fixture(scope="module")
def asset(folder):
    return prepare(folder / "inner" / "good.ply", PreprocessOptions(hull_faces=60, texels=64))


def test_a_hull_that_a_vertex_sticks_out_of_does_not_enclose(asset):
    assert enclosure(asset) == {"enclosed": True, "outside": 0}
    for scale in (0.9, 0.99999):
        cut = asset.hull | {"positions": asset.positions * np.float32(scale), "faces": asset.faces}
        assert enclosure(replace(asset, hull=cut), samples=100)["enclosed"] is False


def test_the_tree_of_another_surface_is_told_apart(asset):
    cameras = cameras_of(asset, 12)
    assert silhouettes(asset, cameras, 64)["mismatches"] == 0
    other = {"positions": asset.positions * np.float32([1.0, 0.8, 1.0]), "faces": asset.faces}
    tree = build_tree(other["positions"], asset.faces, *asset.edges, lambda _: None)
    mesh = other | {"edge_vertices": asset.edges[0], "edge_faces": asset.edges[1]}
    assert silhouettes(replace(asset, tree=SilhouetteTree(mesh, tree.tensors())), cameras, 64)["mismatches"] > 6


def test_views_are_the_same_in_every_run_and_of_every_kind(asset):
    assert cameras_of(asset, 24) == cameras_of(asset, 24)
    flat = [camera.projection == "orthographic" for camera in cameras_of(asset, 24)]
    assert flat == [kind == "orthographic" for kind in EYE_KINDS] * 2
    places = asset.frame.to_normalised(np.array([camera.eye for camera in cameras_of(asset, 24)]))
    distance = np.linalg.norm(places, axis=1)
    around = np.array([kind == "around" for kind in EYE_KINDS] * 2)
    assert (distance[around] > 1.4).all() and (distance[around] < 4.1).all()
    assert distance.min() < 0.5


def test_alpha_error_counts_pixels_that_either_covers_in_part_or_that_differ():
    made = np.array([[0, 255, 51, 255, 0]], np.uint8)
    true = np.array([[0.0, 1.0, 0.4, 0.0, 0.1]], np.float32)
    assert alpha_error(made, true) == pytest.approx((0.2 + 1.0 + 0.1) / 3.0)
    assert alpha_error(made[:, :2], true[:, :2]) == 0.0
