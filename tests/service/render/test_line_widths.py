"""Widths of strokes, across exact visible silhouette edges, of both methods that have one width; and what made them wider or narrower."""

from __future__ import annotations

import math

import numpy as np
import pytest

from benchmarks.line_widths import BAR, METHODS, WIDTHS, alone, inked, line_points, loaded, measure, widths_found
from schemas.lines import LineMethod
from schemas.render import Camera, RenderRequest
from service.kernels.stroke_turns import UNKNOWN, turns_at_ends
from tests import meshes
from tests.meshes import shared
from tests.service.render.made import bare, without_hull


@pytest.mark.parametrize("name", ["torus", "knot", "bumpy"])
def test_strokes_of_every_width_are_as_wide_as_was_asked(gpu, name):
    found = measure(gpu, bare(name), views=4, side=400)
    for method in METHODS:
        for one in found[method.value]:
            assert one["points"] > 200
            assert one["within"] >= BAR, (method, one)


def off_by(gpu, asset, camera, side, width, chosen=lambda pixels: np.ones(len(pixels), bool)):
    """(n,) f8 pixels by which fattened strokes are wider than asked, across chosen points of a view."""
    points = line_points(asset, camera, side)
    rows = alone(points, LineMethod.FATTENED, width, side)
    rows = rows[chosen(points.pixels[rows])]
    return widths_found(inked(gpu, asset, camera, side, LineMethod.FATTENED, width), points, rows, LineMethod.FATTENED, width) - width


def test_a_shallow_step_does_not_cut_the_line_of_what_stands_before_it(gpu):
    """A plate five pixels' sizes before a wall has the whole of a line that is wider than that."""
    wall, plate = meshes.cube(2), meshes.cube(1)
    asset = without_hull(
        "plate before a wall", meshes.joined((wall[0] * [3, 3, 1], wall[1]), (plate[0] * [1, 1, 0.1] + [1, 1, 1.05], plate[1]))
    )
    camera = Camera(eye=[1.5, 1.5, 40.0], target=[1.5, 1.5, 1.0], fov_y_deg=5.0)
    off = off_by(gpu, asset, camera, 300, 20.0, lambda pixels: np.abs(pixels - 150.0).max(axis=1) < 60.0)
    assert len(off) > 200
    assert (np.abs(off) <= 0.5).mean() >= 0.98  # all but those at the corners


@pytest.mark.parametrize("width", [8.0, 20.0])
def test_strokes_do_not_spill_over_the_surface_where_outlines_end_in_folds(gpu, width):
    """In the hole of a coarse torus the outline has spikes, whose other side is over the surface."""
    camera = {"orbit": {"azimuth_deg": 30, "elevation_deg": 20}}
    off = off_by(gpu, bare("torus"), RenderRequest(camera=camera).camera, 512, width)
    assert len(off) > 1000
    assert (off > 0.5).mean() <= 0.01


@pytest.mark.heavy
@pytest.mark.parametrize("name", ["fandisk.ply", "rocker_arm.ply", "bunny_closed.ply"])
def test_strokes_of_real_meshes_are_as_wide_as_was_asked(gpu, name):
    found = measure(gpu, loaded(shared(name)), views=4, side=512, widths=(WIDTHS[0], WIDTHS[-1]))
    for method in METHODS:
        for one in found[method.value]:
            assert one["points"] > 1000
            assert one["within"] >= BAR, (method, one)


def test_widths_of_ink_are_measured_as_they_are():
    """Of bands of ink beside a straight edge, with what is beside other lines left out."""
    asset, camera = bare("cube"), Camera(eye=[0.5, 0.5, 6.0], target=[0.5, 0.5, 0.0], fov_y_deg=math.degrees(2.0 * math.atan(0.2)))
    points = line_points(asset, camera, 200)
    rows = alone(points, LineMethod.FATTENED, 8.0, 200)
    away = np.abs(np.stack(np.meshgrid(*2 * [np.arange(200) + 0.5 - 100.0]), axis=2)).max(axis=2) - 50.0
    for width in (6.0, 8.0, 9.5):
        ink = np.clip(width + 0.5 - away, 0.0, 1.0) * (away > 0.0)
        off = np.abs(widths_found(ink, points, rows, LineMethod.FATTENED, 8.0) - width)
        assert (off < 0.05).mean() > 0.97  # all but those at the corners
    assert np.array_equal(np.unique(np.abs(points.outwards[rows]).round(6), axis=0), [[0.0, 1.0], [1.0, 0.0]])
    balls = without_hull("two balls side by side", meshes.joined(*(meshes.sphere(3, 0.5, (x, 0.0, 0.0)) for x in (-0.55, 0.55))))
    both = line_points(balls, Camera(eye=[0.0, 0.0, 9.0], fov_y_deg=20.0), 200)
    kept = both.pixels[alone(both, LineMethod.FATTENED, 8.0, 200)]
    assert not (np.abs(kept - 100.0) < 7.0).all(axis=1).any()  # the gap holds no two strokes
    assert len(kept) > 100


def turns_of(positions, ends, nearest=0.5):
    """(n, 2) radians at the ends of edges in the plane of an image whose rows run down."""
    turns = np.empty((len(ends), 2))
    turns_at_ends(np.diag([100.0, -100.0, 1.0, 1.0]), nearest, 1.0, np.array(positions, np.float32), np.array(ends, np.int32), turns)
    return turns


@pytest.mark.parametrize("degrees", [-150.0, -30.0, 0.0, 20.0, 90.0, 170.0])
def test_outlines_turn_outwards_where_the_face_is_on_the_inner_side(degrees):
    """Counter-clockwise about the face: to the left is outwards."""
    place = [1.0 + math.cos(math.radians(degrees)), math.sin(math.radians(degrees))]
    turns = turns_of([[0, 0, 0], [1, 0, 0], [*place, 0]], [[0, 1, 9, 1], [1, 2, 9, 1]])
    assert np.degrees(turns[0, 1]) == pytest.approx(degrees, abs=1e-4)
    assert np.degrees(turns[1, 0]) == pytest.approx(degrees, abs=1e-4)
    assert turns[0, 0] == turns[1, 1] == UNKNOWN


def test_turns_are_not_known_where_more_than_two_edges_meet_or_before_the_eye():
    positions, ends = [[0, 0, 0], [1, 0, 0], [2, 1, 0], [2, -1, 0]], [[0, 1, 9, 1], [1, 2, 9, 1], [3, 1, 9, 1]]
    assert (turns_of(positions, ends) == UNKNOWN).all()
    assert (turns_of(positions, ends[:2], nearest=2.0) == UNKNOWN).all()
    assert (turns_of(positions, ends[:2]) == UNKNOWN).sum() == 2
