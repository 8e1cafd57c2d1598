"""Labels never hide one another, and stand as near to their points as that allows."""

from __future__ import annotations

import math
from itertools import pairwise

import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from scipy.optimize import minimize

from service.accuracy.labels import farthest_apart, spread

PLACES = st.lists(st.floats(0.0, 300.0), min_size=1, max_size=8).map(sorted)
POINTS = st.lists(st.tuples(st.integers(0, 50), st.integers(0, 50)), min_size=1, max_size=20)


@given(PLACES)
def test_labels_are_apart_in_order_and_within_the_lane(wanted):
    places = spread(wanted, 23.0, 10.0, 290.0)
    assert all(b - a >= 23.0 - 1e-9 for a, b in pairwise(places))
    assert places[0] >= 10.0
    assert places[-1] <= 290.0 + 1e-9


@given(st.lists(st.floats(100.0, 200.0), min_size=2, max_size=4).map(sorted))
def test_labels_are_where_least_squares_puts_them(wanted):
    places = spread(wanted, 10.0, 0.0, 300.0)
    apart = [{"type": "ineq", "fun": lambda x, k=k: x[k + 1] - x[k] - 10.0} for k in range(len(wanted) - 1)]
    start = [wanted[0] + 12.0 * k for k in range(len(wanted))]
    best = minimize(lambda x: sum((a - b) ** 2 for a, b in zip(x, wanted, strict=True)), start, constraints=apart)
    assume(best.success)
    assert places == pytest.approx(list(best.x), abs=0.05)


def test_labels_that_have_room_stand_at_their_points():
    assert spread([20.0, 50.0, 90.0], 23.0, 10.0, 290.0) == [20.0, 50.0, 90.0]


@given(POINTS, st.integers(2, 6))
def test_named_points_are_the_ends_and_those_that_leave_none_far_from_all(points, most):
    chosen = farthest_apart(points, most)
    assert len(chosen) == min(len(points), most)
    assert {0, len(points) - 1} <= set(chosen)
    left = max(min(math.dist(point, points[c]) for c in chosen) for point in points)
    ends = {0, len(points) - 1}
    apart = [math.dist(points[a], points[b]) for a in chosen for b in chosen if a < b and {a, b} != ends]
    assert len(points) <= most or left <= min(apart, default=math.inf)
