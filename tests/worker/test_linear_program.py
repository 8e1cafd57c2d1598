from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import linprog

from worker.kernels.linear_program import BOX_ROWS, INFEASIBLE, OPTIMAL, UNBOUNDED, solve3

REACH = 16.0


def solve(normals, offsets, objective, reach=REACH):
    n = np.array(normals, np.float64).reshape(-1, 3)
    b = np.array(offsets, np.float64)
    status, *x = solve3(n, b, len(b), np.array(objective, np.float64), reach, np.empty((len(b) + BOX_ROWS, 3)))
    return status, np.array(x)


def reference(normals, offsets, objective, reach=REACH):
    return linprog(objective, A_ub=-np.asarray(normals), b_ub=-np.asarray(offsets), bounds=[(-reach, reach)] * 3, method="highs")


def agrees(normals, offsets, objective):
    """The answer is feasible and as good as the reference's, or both say that there is none."""
    normals, offsets = np.asarray(normals, float).reshape(-1, 3), np.asarray(offsets, float)
    status, x = solve(normals, offsets, objective)
    length = np.linalg.norm(normals, axis=1)
    if status == INFEASIBLE:
        # HiGHS forgives 1e-7: what we call infeasible must be so after loosening by more than it forgives
        return reference(normals, offsets + 1e-6 * length, objective).status == 2
    assert np.all(np.abs(x) <= REACH * (1 + 1e-9))
    assert np.all(normals @ x >= offsets - 1e-9 * np.maximum(length, 1e-300))
    best = reference(normals, offsets, objective)
    if best.status != 0:  # the reference found it infeasible by its own tolerance
        return reference(normals, offsets - 1e-6 * length, objective).status == 0
    scale = max(1e-300, float(np.abs(objective).sum()))
    return np.dot(objective, x) <= best.fun + 1e-5 * scale


small = st.floats(-3, 3, allow_nan=False).map(lambda v: round(v, 3))
grid = st.integers(-2, 2).map(float)


@st.composite
def programs(draw, number):
    count = draw(st.integers(0, 24))
    rows = draw(st.lists(st.tuples(number, number, number), min_size=count, max_size=count))
    rows = [r if any(r) else (1.0, 0.0, 0.0) for r in rows]
    offsets = draw(st.lists(number, min_size=count, max_size=count))
    return rows, offsets, draw(st.tuples(number, number, number))


@settings(max_examples=150, deadline=None)
@given(programs(small))
def test_equals_the_reference_on_random_constraints(program):
    assert agrees(*program)


@settings(max_examples=150, deadline=None)
@given(programs(grid))
def test_equals_the_reference_on_parallel_and_duplicate_constraints(program):
    assert agrees(*program)


@settings(max_examples=100, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(4, 60))
def test_a_bundle_of_nearly_parallel_planes_keeps_its_optimum(seed, count):
    rng = np.random.default_rng(seed)
    normals = np.array([0, 0, 1.0]) + rng.normal(size=(count, 3)) * 10.0 ** rng.uniform(-9, -1)
    inside = rng.normal(size=3)
    assert agrees(normals, normals @ inside - rng.uniform(0, 1e-3, count), normals.sum(axis=0))


@settings(max_examples=100, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_an_objective_made_of_the_normals_is_never_below_their_offsets(seed):
    rng = np.random.default_rng(seed)
    normals, weights = rng.normal(size=(12, 3)), rng.uniform(0, 1, 12)
    offsets = rng.normal(size=12) - 1.0
    status, x = solve(normals, offsets, weights @ normals)
    assert status == INFEASIBLE or (weights @ normals) @ x >= weights @ offsets - 1e-9


def test_three_planes_meet_in_their_corner():
    status, x = solve(np.eye(3), [1.0, 2.0, 3.0], [1.0, 1.0, 1.0])
    assert status == OPTIMAL
    assert np.allclose(x, [1, 2, 3], atol=1e-12)


def test_without_a_bound_the_box_is_reported():
    status, x = solve([[1.0, 0, 0]], [0.0], [0.0, 0.0, -1.0])
    assert status == UNBOUNDED
    assert x[2] == REACH


def test_ties_are_broken_towards_the_origin():
    status, x = solve([[0, 0, 2.0]], [1.0], [0.0, 0.0, 5.0])
    assert status == OPTIMAL
    assert np.allclose(x, [0, 0, 0.5], atol=1e-14)


def test_opposite_constraints_that_touch_are_feasible_and_that_cross_are_not():
    touching = solve([[0, 0, 1.0], [0, 0, -1.0]], [0.25, -0.25], [1.0, 0, 0])
    assert touching[0] == UNBOUNDED
    assert abs(touching[1][2] - 0.25) < 1e-11
    assert solve([[0, 0, 1.0], [0, 0, -1.0]], [0.25, -0.249], [1.0, 0, 0])[0] == INFEASIBLE


@pytest.mark.parametrize(("offset", "status"), [(-1.0, OPTIMAL), (0.0, OPTIMAL), (1e-30, INFEASIBLE)])
def test_a_zero_normal_is_void_or_infeasible(offset, status):
    assert solve([[0.0, 0, 0], [0, 0, 1.0]], [offset, 0.0], [0, 0, 1.0])[0] == status


@pytest.mark.parametrize("size", [1e-150, 1e-30, 1e30, 1e150])
def test_the_length_of_a_normal_does_not_matter(size):
    status, x = solve(np.eye(3) * size, np.array([1.0, 2.0, 3.0]) * size, [1e-200, 1e-200, 1e-200])
    assert status == OPTIMAL
    assert np.allclose(x, [1, 2, 3], rtol=1e-9)


def test_equal_input_gives_equal_bits():
    rng = np.random.default_rng(3)
    normals, offsets = rng.normal(size=(40, 3)), -rng.uniform(0, 1, 40)
    first, second = (solve(normals, offsets, [0.3, -0.2, 0.9]) for _ in range(2))
    assert first[0] == second[0]
    assert np.array_equal(first[1], second[1])


def test_no_constraints_and_no_objective_give_the_origin():
    status, x = solve(np.empty((0, 3)), [], [0.0, 0.0, 0.0])
    assert status == OPTIMAL
    assert not x.any()
