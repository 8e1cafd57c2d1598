"""Faces that can hold the middle of a pixel, against every pixel of the target by exact arithmetic."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from service.kernels.sampled_faces import LARGE_PX, place_vertices, sampled_faces

SIDE = 8
coordinate = st.floats(-3.0, SIDE + 3.0, width=32) | st.integers(-6, 2 * SIDE + 6).map(lambda half: half / 2)
triangle = st.lists(st.tuples(coordinate, coordinate), min_size=3, max_size=3)
FLAT = np.eye(4)


def kept_of(corners, matrix=FLAT):
    """Whether the face with these corners (3, 3) is kept."""
    positions = np.array(corners, np.float32)
    placed, kept = np.empty((2, 3), np.float32), np.empty(1, np.int32)
    place_vertices(matrix, positions, placed)
    size = np.full(2, SIDE, np.float32)
    return sampled_faces(placed, size, np.array([[0, 1, 2]], np.int32), np.zeros(1, np.int32), kept) == 1


def holds_a_middle(corners):
    points = [(Fraction(x), Fraction(y)) for x, y in corners]
    for row in range(SIDE):
        for column in range(SIDE):
            p = (column + Fraction(1, 2), row + Fraction(1, 2))
            turns = [
                (b[0] - a[0]) * (p[1] - a[1]) - (b[1] - a[1]) * (p[0] - a[0]) for a, b in zip(points, points[1:] + points[:1], strict=True)
            ]
            if any(turns) and (min(turns) >= 0 or max(turns) <= 0):
                return True
    return False


@settings(deadline=None)
@given(triangle)
def test_no_face_that_holds_the_middle_of_a_pixel_is_left_out(corners):
    corners = [(float(np.float32(x)), float(np.float32(y))) for x, y in corners]
    if holds_a_middle(corners):
        assert kept_of([(x, y, 0.0) for x, y in corners])


@settings(deadline=None)
@given(st.integers(0, SIDE - 1), st.integers(0, SIDE - 1), st.floats(0.02, 0.3), st.floats(0.0, 6.3))
def test_small_faces_between_middles_are_left_out(column, row, radius, angle):
    turns = angle + np.arange(3) * 2.0 * np.pi / 3.0
    corners = np.stack([column + radius * np.cos(turns), row + radius * np.sin(turns), np.zeros(3)], axis=1)
    assert not kept_of(corners)


def test_faces_outside_the_target_are_left_out_and_large_ones_within_are_kept():
    large = np.array([[0, 0, 0], [float(LARGE_PX) + 1, 0, 0], [0, 0.1, 0]])
    assert kept_of(large)
    assert not kept_of(large + np.array([SIDE + 1, 0, 0]))
    assert not kept_of(large - np.array([0, 1, 0]))


def test_faces_that_reach_behind_the_eye_are_kept():
    through = FLAT.copy()
    through[3] = [0.0, 0.0, 1.0, 0.0]
    assert kept_of([[1, 1, 1], [1.1, 1, 1], [1, 1.1, -1]], through)
    assert not kept_of([[1, 1, 1], [1.1, 1, 1], [1, 1.1, 1]], through)
