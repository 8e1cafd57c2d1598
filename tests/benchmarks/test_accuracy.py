"""The command measures a real mesh in a process of its own, since it makes a GL context."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from benchmarks.accuracy import bars, name_of, print_table
from client.shapes import write_ply
from schemas.ladder import RungKey
from tests import meshes

pytestmark = pytest.mark.xdist_group("accuracy")  # one run of the benchmark for all tests

ROOT = Path(__file__).resolve().parents[2]
FIELDS = {"alpha_error", "alpha_rmse", "wrong_pixels", "distance_px", "psnr", "ssim", "ms", "bound_px"}


def run(path, *options):
    command = [sys.executable, "-m", "benchmarks.accuracy", str(path), "--size", "96", "--views", "2", "--texels", "256", *options]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True).stdout


@pytest.fixture(scope="module")
def mesh(tmp_path_factory):
    path = tmp_path_factory.mktemp("meshes") / "knot.ply"
    write_ply(str(path), *meshes.knot())
    return path


@pytest.fixture(scope="module")
def result(mesh):
    return json.loads(run(mesh, "--stencil", "3", "--samples", "2", "--json"))


def test_every_rung_has_its_errors_its_time_and_its_bound(result):
    assert (result["mesh"], result["faces"], result["size"], result["views"]) == ("knot.ply", 5120, 96, 2)
    rungs = result["rungs"]
    assert all(FIELDS | set(RungKey.model_fields) <= set(rung) for rung in rungs)
    assert {rung["level"] for rung in rungs} > {None, 0}
    assert len({rung["hull_faces"] for rung in rungs} - {None}) >= 2
    assert len({name_of(rung) for rung in rungs}) == len(rungs)


def test_bars_are_reached_by_the_exact_outlines_of_a_knot(result):
    own = {(rung["source"], rung["antialias"]): rung["alpha_error"] for rung in result["rungs"] if rung["level"] is None}
    coverage = next(bar for bar in result["bars"] if bar["name"] == "coverage alpha error")
    assert coverage["value"] == own["clipped", "coverage"] and coverage["met"]
    assert next(bar for bar in result["bars"] if bar["name"].startswith("line"))["met"]


def test_the_stencil_hardly_differs_from_the_original(result):
    stencil = result["stencil"]
    assert stencil["views"] == 3
    assert stencil["total"] == pytest.approx(stencil["pixels"] / (3 * 96**2))
    assert stencil["total"] <= stencil["worst"] <= 1e-3


@pytest.fixture(scope="module")
def more(mesh):
    return json.loads(run(mesh, "--samples", "4096", "--json"))


def test_samples_are_those_of_msaa_as_far_as_the_driver_goes(result, more):
    few, many = (
        {rung["antialias"]: rung["alpha_error"] for rung in one["rungs"] if rung["source"] == "original"} for one in (result, more)
    )
    assert 2 <= result["msaa_samples"] < more["msaa_samples"] < 4096
    assert many["msaa"] < few["msaa"] and many["none"] == few["none"]


def test_the_table_tells_bars(more, capsys):
    print_table(more)
    text = capsys.readouterr().out
    assert "met: coverage alpha error: " in text
    assert "clipped/coverage, hull " in text and "stencil" not in text


def test_a_bar_that_is_not_reached_is_told():
    sources = [("clipped", "coverage", 0.01), ("clipped", "line", 0.06), ("original", "msaa", 0.06)]
    rungs = [{"source": s, "antialias": a, "level": None, "alpha_error": e, "alpha_rmse": 0.01} for s, a, e in sources]
    met = {bar["name"]: bar["met"] for bar in bars({"rungs": rungs, "stencil": {"worst": 2e-4}})}
    assert met == {
        "coverage alpha error": False,
        "coverage alpha error, a third of msaa's": True,
        "coverage alpha rmse": True,
        "line alpha error": True,
        "stencil, part of pixels that differ, worst view": False,
    }
