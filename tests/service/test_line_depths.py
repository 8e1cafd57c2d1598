"""Vector lines against a depth buffer of the GL's, which rays and cuts have no part in."""

from __future__ import annotations

from dataclasses import replace

import pytest

from benchmarks.line_depths import BAR, compared, depth_buffer, lines_of, measure
from benchmarks.lines import loaded
from schemas.render import Camera
from tests import meshes
from tests.meshes import shared
from tests.service.render.made import bare, unclippable, without_hull

ORTHOGRAPHIC = Camera(eye=[3.0, 2.0, 4.0], projection="orthographic", height=2.6)
CLOSE = Camera(eye=[1.3, 0.8, 1.7], fov_y_deg=60.0)


def counts(gpu, asset, camera, side=1024, turned=False):
    """Of one view: points, sure, agreeing, hidden. turned: what is visible is said to be hidden, and the other way round."""
    pieces, view = lines_of(asset, camera, side)
    pieces = replace(pieces, visible=~pieces.visible) if turned else pieces
    return compared(pieces, view, depth_buffer(gpu, asset, camera, side))


@pytest.mark.parametrize("camera", [ORTHOGRAPHIC, CLOSE], ids=["orthographic", "close"])
@pytest.mark.parametrize("name", ["torus", "knot", "bumpy", "joined", "open knot"])
def test_what_a_depth_buffer_hides_is_hidden(gpu, name, camera):
    asset = unclippable("knot") if name.startswith("open") else bare(name)
    points, sure, agree, hidden = counts(gpu, asset, camera)
    assert sure > 0.7 * points > 300
    assert 0.02 * sure < hidden < 0.98 * sure
    assert agree >= 0.99 * sure


def test_a_line_that_is_wrongly_hidden_or_shown_would_be_told(gpu):
    _, sure, agree, _ = counts(gpu, bare("knot"), CLOSE, turned=True)
    assert agree < 0.02 * sure


def test_bodies_through_each_other_hide_as_a_depth_buffer_does(gpu):
    balls = meshes.joined(meshes.sphere(4), meshes.sphere(4, 0.8, (0.7, 0.3, 0.5)), meshes.torus(40, 20, 1.2, 0.3))
    found = measure(gpu, without_hull("balls through a ring", balls), views=4, side=1024)
    assert found["points"] > 2000 and found["sure"] > 70.0
    assert found["agree"] >= BAR


@pytest.mark.heavy
@pytest.mark.parametrize("name", ["fandisk.ply", "trim-star.off", "rocker_arm.ply", "many_small_holes.ply", "bunny_closed.ply"])
def test_lines_of_real_meshes_are_hidden_as_in_a_depth_buffer(gpu, name):
    found = measure(gpu, loaded(shared(name)), views=3, side=2048)
    assert found["points"] > 3000 and found["sure"] > 60.0
    assert found["agree"] >= BAR
