"""Planes between convex bodies, against a linear program."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import linprog

from service.kernels.separation import separating_plane, shrunk

CUBE = np.array([[i & 1, i >> 1 & 1, i >> 2] for i in range(8)], np.float64)


def gap(a, b):
    """Half the widest gap between a and b along directions of largest coordinate one; 0 when they meet."""
    rows_a = np.column_stack([a, -np.ones(len(a)), np.ones(len(a))])
    rows_b = np.column_stack([-b, np.ones(len(b)), np.ones(len(b))])
    rows = np.concatenate([rows_a, rows_b])
    bounds = [(-1, 1)] * 3 + [(None, None)] * 2
    return -linprog([0, 0, 0, 0, -1], A_ub=rows, b_ub=np.zeros(len(rows)), bounds=bounds).fun


def bodies(seed):
    """Two random bodies, sometimes flat, thin, single points or on a grid, so that they are degenerate together."""
    rng = np.random.default_rng(seed)
    a, b = (rng.normal(size=(rng.integers(1, 14), 3)) * 0.4 for _ in range(2))
    b += rng.normal(size=3) * 0.6
    kind = seed % 5
    if kind == 1:
        a[:, 2] = 0.0
        b[:, 2] = rng.choice([0.0, 1e-6, 0.3])
    elif kind == 2:
        a, b = np.round(a * 2), np.round(b * 2)
    elif kind == 3:
        a = a[:1] + np.outer(rng.normal(size=len(a)), rng.normal(size=3))
    elif kind == 4:
        b = b * 1e-5 + rng.normal(size=3)
    return a, b


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=300, deadline=None)
def test_a_plane_is_found_exactly_when_there_is_one(seed):
    a, b = bodies(seed)
    plane = np.empty(4)
    found, widest = separating_plane(a, b, plane), gap(a, b)
    if found:
        assert (a @ plane[:3] < plane[3]).all()
        assert (b @ plane[:3] > plane[3]).all()
        assert np.linalg.norm(plane[:3]) == pytest.approx(1.0)
    if abs(widest) > 1e-8:  # what the linear program itself can tell
        assert found == (widest > 0.0)


def test_the_same_body_twice_is_not_separated():
    assert not separating_plane(CUBE, CUBE.copy(), np.empty(4))
    assert not separating_plane(np.zeros((1, 3)), np.zeros((1, 3)), np.empty(4))


def test_one_inside_the_other_is_not_separated():
    assert not separating_plane(CUBE, 0.4 + 0.2 * CUBE, np.empty(4))
    assert not separating_plane(0.4 + 0.2 * CUBE, CUBE, np.empty(4))


@pytest.mark.parametrize("step", [(1, 0, 0), (-1, 0.3, 0.2), (0, 1, 1), (1, 1, 1), (0.5, 0, -1)])
def test_bodies_that_touch_are_separated_once_shrunk(step):
    plane = np.empty(4)
    other = CUBE + np.array(step, np.float64)
    part = 2.0**-21
    assert not separating_plane(CUBE, other, plane)
    assert separating_plane(shrunk(CUBE, part), shrunk(other, part), plane)
    assert (CUBE @ plane[:3]).max() - plane[3] < 2 * part
    assert plane[3] - (other @ plane[:3]).min() < 2 * part


def test_shrinking_moves_points_towards_their_mean():
    points = np.array([[0.0, 0.0, 0.0], [2.0, 0.0, 0.0], [0.0, 4.0, 0.0], [2.0, 4.0, 8.0]])
    assert np.allclose(shrunk(points, 0.5), (points + points.mean(axis=0)) / 2)


def test_a_body_reached_far_away_among_many_points_is_separated():
    rng = np.random.default_rng(5)
    sphere = rng.normal(size=(3000, 3))
    sphere /= np.linalg.norm(sphere, axis=1, keepdims=True)
    plane = np.empty(4)
    assert separating_plane(sphere, sphere + np.array([2.001, 0.0, 0.0]), plane)
    assert plane[0] > 0.99
    assert not separating_plane(sphere, sphere + np.array([1.9, 0.0, 0.0]), plane)
