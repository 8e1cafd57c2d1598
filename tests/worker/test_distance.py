"""The bound on the distance of a surface from a mesh: never below any point's distance, close to the largest, and stoppable."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from geometry.boxes import build_boxes
from schemas.errors import CancelledError
from tests.meshes import bumpy_sphere, cube, joined, knot, normalised, sphere, torus
from tests.oracles_hull import distances
from worker import distance as module
from worker.distance import RUNGS, DistanceTo
from worker.hull import build_hull
from worker.kernels import level_distance

GAP, FLOOR = RUNGS[-1]
ROUGH = RUNGS[0][1]  # where a surface lies on flat parts of the original the search ends there


def quiet(_):
    pass


def dense(positions, faces, per_side=7):
    """Points all over a surface, corners included."""
    grid = [(i, j, per_side - i - j) for i in range(per_side + 1) for j in range(per_side + 1 - i)]
    weights = np.array(grid, np.float64) / per_side
    return np.einsum("wk,fki->fwi", weights, positions[faces].astype(np.float64)).reshape(-1, 3)


def brute_farthest(level, original, per_side=7):
    return distances(*original, dense(*level, per_side)).max()


def measured(level, original):
    return DistanceTo(*original).of(*level, quiet)


def as_arrays(mesh):
    positions, faces, _ = normalised(mesh)
    return positions, faces


@pytest.mark.parametrize("mesh", [bumpy_sphere(2), torus(16, 8), knot(50, 6), cube(4), joined(sphere(1), sphere(1, centre=(1.2, 0, 0)))])
@pytest.mark.parametrize("faces", [20, 80])
def test_no_point_of_a_hull_is_further_than_its_bound_and_the_bound_is_tight(mesh, faces):
    original = as_arrays(mesh)
    hull = build_hull(*original, faces, quiet)
    found = measured((hull.positions, hull.faces), original)
    farthest = brute_farthest((hull.positions, hull.faces), original)
    assert farthest <= found.bound
    assert found.least <= found.bound <= max((1.0 + GAP) * found.least, ROUGH) + 1e-9
    assert found.least <= farthest * 1.1 + FLOOR


triangle_soups = st.builds(
    lambda seed, count, size: (
        np.random.default_rng(seed).uniform(-1, 1, (3 * count, 3)).astype(np.float32) * np.float32(size),
        np.arange(3 * count, dtype=np.int32).reshape(-1, 3),
    ),
    st.integers(0, 2**32 - 1),
    st.integers(1, 12),
    st.sampled_from([1.0, 0.3, 1e-3]),
)


@settings(max_examples=60, deadline=None)
@given(level=triangle_soups, original=triangle_soups)
def test_the_bound_holds_for_any_triangles(level, original):
    found = measured(level, original)
    farthest = brute_farthest(level, original)
    assert farthest <= found.bound
    assert found.bound <= max((1.0 + GAP) * found.least, ROUGH) + 1e-9
    assert found.least <= farthest + brute_spacing(level)


def brute_spacing(level):
    """How far a point of a level can be from the nearest one of `dense`."""
    corners = level[0][level[1]].astype(np.float64)
    return float(np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max()) / 7.0


@pytest.mark.parametrize(
    "degenerate", [[[0, 0, 0], [0, 0, 0], [0, 0, 0]], [[0, 0, 0], [1, 0, 0], [0.5, 0, 0]], [[0, 0, 0], [1, 1e-7, 0], [0.5, 0, 1e-7]]]
)
def test_points_and_needles_have_distances_too(degenerate):
    needle = (np.float32(degenerate), np.array([[0, 1, 2]], np.int32))
    ball = as_arrays(sphere(1))
    for level, original in ((needle, ball), (ball, needle)):
        found = measured(level, original)
        assert brute_farthest(level, original) <= found.bound
        assert found.bound <= 1.04 * found.least + FLOOR


def test_a_mesh_is_at_no_distance_from_itself():
    for mesh in (cube(5), bumpy_sphere(2)):
        original = as_arrays(mesh)
        assert measured(original, original).bound <= FLOOR


def test_flat_sides_of_fewer_faces_lie_on_the_original():
    fine, coarse = as_arrays(cube(6)), as_arrays(cube(1))
    found = measured(coarse, fine)
    assert found.least <= 1e-7
    assert found.bound <= ROUGH + 1e-9


def test_an_offset_is_found():
    original = as_arrays(sphere(3))
    for factor in (1.5, 1.01, 1.0001):
        grown = ((original[0].astype(np.float64) * factor).astype(np.float32), original[1])
        found = measured(grown, original)
        assert factor - 1.0 <= found.bound * (1.0 + 1e-6) <= (factor - 1.0) * 1.05 + FLOOR


def test_a_search_that_gives_up_still_has_a_true_bound(monkeypatch):
    monkeypatch.setattr(module, "CUTS_A_FACE", 0)
    monkeypatch.setattr(module, "CUTS", 20)
    original = as_arrays(bumpy_sphere(2))
    hull = build_hull(*original, 40, quiet)
    level = (hull.positions, hull.faces)
    found = measured(level, original)
    assert found.bound >= brute_farthest(level, original)
    assert found.bound > (1.0 + GAP) * found.least


def test_the_same_meshes_have_the_same_bound():
    original = as_arrays(knot(50, 6))
    hull = build_hull(*original, 100, quiet)
    assert measured((hull.positions, hull.faces), original) == measured((hull.positions, hull.faces), original)


def test_progress_rises_to_one_and_may_cancel(monkeypatch):
    monkeypatch.setattr(module, "_POINTS_A_CHUNK", 50)
    monkeypatch.setattr(module, "_FACES_A_CHUNK", 50)
    original, seen = as_arrays(sphere(2)), []
    DistanceTo(*original).of(*original, seen.append)
    assert len(seen) > 10 and seen == sorted(seen) and seen[-1] == 1.0

    def cancel(part):
        if part > 0.5:
            raise CancelledError("the mesh was deleted")

    with pytest.raises(CancelledError):
        DistanceTo(*original).of(*original, cancel)


def test_closest_faces_are_those_of_a_look_at_all_faces():
    positions, faces = as_arrays(bumpy_sphere(2))
    points = np.random.default_rng(1).uniform(-1.2, 1.2, (200, 3)).astype(np.float32)
    order, boxes = build_boxes(positions, faces)
    closest, state = np.empty(len(points), np.int32), np.zeros(3)
    level_distance.nearest_faces(positions, faces, order, boxes, points, 0, len(points), closest, state)
    nearest = distances(positions, faces, points)
    found = [distances(positions, faces[face][None], points[n : n + 1])[0] for n, face in enumerate(closest)]
    assert np.allclose(found, nearest, atol=1e-12)
    assert np.sqrt(state[level_distance.LOW]) == pytest.approx(nearest.max(), abs=1e-12)


def test_a_later_rung_searches_only_the_faces_whose_bounds_it_needs_lower():
    (positions, faces), (points, triangles) = (part[:2] for part in (normalised(sphere(3)), normalised(bumpy_sphere(3))))
    order, boxes = build_boxes(positions, faces)
    mesh, state, bounds = (positions, faces, order, boxes), np.zeros(3), np.full(len(triangles), np.inf)
    closest = np.empty(len(points), np.int32)
    level_distance.nearest_faces(*mesh, points, 0, len(points), closest, state)
    for factor in (2.0, 1.0):
        state[level_distance.HIGH], state[level_distance.CUTS_LEFT] = 0.0, 10_000
        level_distance.bound_faces(*mesh, points, triangles, closest, bounds, 0, len(triangles), 0.1 * factor, 0.0, state)
        assert state[level_distance.HIGH] == bounds.max() <= (1.0 + 0.1 * factor) ** 2 * state[level_distance.LOW]
    state[level_distance.HIGH], state[level_distance.CUTS_LEFT], known = 0.0, 10_000, bounds.copy()
    level_distance.bound_faces(*mesh, points, triangles, closest, bounds, 0, len(triangles), 0.1, 0.0, state)
    assert state[level_distance.CUTS_LEFT] == 10_000 and np.array_equal(bounds, known)
    assert state[level_distance.HIGH] == known.max()
