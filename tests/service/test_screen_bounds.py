from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from schemas.conventions import Frame
from schemas.render import Camera
from service.camera import project, resolve_camera, to_pixels
from service.kernels.screen_bounds import NOTHING, SOME, UNKNOWN, screen_bounds

UNIT = Frame((0.0, 0.0, 0.0), 1.0)


def view_from(eye, **options):
    return resolve_camera(Camera(eye=list(eye), target=[0.0, 0.0, 0.0], **options), UNIT, 200, 100)


def bounds(view, points, border=2):
    return screen_bounds(view.matrix, points, view.width, view.height, border)


@settings(deadline=None)  # compiling counts
@given(st.integers(0, 1000), st.booleans())
def test_bounds_are_those_of_the_projected_points(seed, orthographic):
    rng = np.random.default_rng(seed)
    points = rng.uniform(-0.5, 0.5, (12, 3)).astype(np.float32)
    eye = rng.normal(size=3)
    view = view_from(eye / np.linalg.norm(eye) * 3.0, **({"projection": "orthographic", "height": 2.0} if orthographic else {}))
    kind, *box = bounds(view, points)
    pixels = to_pixels(view, project(view, points))
    assert kind == SOME
    assert np.allclose(box, [*pixels.min(axis=0), *pixels.max(axis=0)], atol=1e-9)


@pytest.mark.parametrize("direction", [(0, 9, 0), (0, -9, 0), (9, 0, 0), (-9, 0, 0)])
def test_points_beyond_one_side_are_nothing(direction):
    points = np.random.default_rng(0).uniform(-0.5, 0.5, (12, 3)) + np.array(direction)
    assert bounds(view_from((0, 0, 3)), points)[0] == NOTHING


def test_points_behind_the_eye_are_nothing_and_points_on_both_sides_unknown():
    points = np.random.default_rng(0).uniform(-0.5, 0.5, (12, 3))
    assert bounds(view_from((0, 0, 3)), points + np.array([0.0, 0.0, 5.0]))[0] == NOTHING
    assert bounds(view_from((0, 0, 0.1)), points)[0] == UNKNOWN


def test_points_within_the_border_still_count():
    view = view_from((0, 0, 4), projection="orthographic", height=1.0)  # 100 pixels a unit, 200 wide
    point = np.array([[1.015, 0.0, 0.0]])
    assert bounds(view, point, 2)[0] == SOME
    assert bounds(view, point, 1)[0] == NOTHING
