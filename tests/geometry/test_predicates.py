from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numba import njit

from geometry.predicates import front_facing, orient2d_sign, orient_sign
from tests import degenerate, eye_cases, meshes, oracles, oracles_integer

grid = st.integers(-8, 8).map(lambda i: i / 8.0)
anywhere = st.floats(-4, 4, width=32, allow_subnormal=False).filter(lambda x: x == 0 or abs(x) > 1e-20)
point = st.one_of(st.tuples(grid, grid, grid), st.tuples(anywhere, anywhere, anywhere))


@settings(max_examples=300, deadline=None)
@given(point, point, point, point, st.sampled_from([0.0, 1.0]))
def test_orientation_is_the_rational_one(a, b, c, p, w):
    corners = [np.array(x, np.float32) for x in (a, b, c)]
    assert orient_sign(*corners, *(float(x) for x in p), w) == oracles.orientation(*corners, (*p, w))


@settings(max_examples=200, deadline=None)
@given(point, point, point, st.tuples(grid, grid), st.integers(-3, 3))
def test_orientation_is_exact_within_a_few_roundings_of_the_plane(a, b, c, weights, ulps):
    corners = [np.array(x, np.float32) for x in (a, b, c)]
    a8, b8, c8 = (x.astype(np.float64) for x in corners)
    p = a8 + weights[0] * (b8 - a8) + weights[1] * (c8 - a8)
    for _ in range(abs(ulps)):
        p[2] = np.nextafter(p[2], np.inf * ulps)
    assert orient_sign(*corners, *p, 1.0) == oracles.orientation(*corners, (*p, 1.0))


@pytest.mark.parametrize("scale", [1e12, 1e100])
def test_orientation_holds_for_far_eyes_over_a_plane(scale):
    a, b, c = (np.array(x, np.float32) for x in ((0.1, 0.2, 0.3), (0.7, 0.2, 0.3), (0.1, 0.9, 0.3)))
    height = float(np.float32(0.3))
    for z in (height, np.nextafter(height, 1.0), np.nextafter(height, 0.0)):
        eye = (scale, -scale, z, 1.0)
        assert orient_sign(a, b, c, *eye) == oracles.orientation(a, b, c, eye) == int(z > height) - int(z < height)


@pytest.mark.parametrize("pair", [(0, 1), (0, 2), (1, 2), (0, 3), (1, 3), (2, 3)])
def test_orientation_of_points_two_of_which_are_the_same_is_zero(pair):
    points = np.random.default_rng(5).normal(size=(4, 3)).astype(np.float32)
    points[pair[1]] = points[pair[0]]
    a, b, c, p = points
    assert orient_sign(a, b, c, *p.astype(np.float64), 1.0) == oracles.orientation(a, b, c, (*p.astype(np.float64), 1.0)) == 0


def test_a_face_without_area_is_front_facing_for_every_eye():
    positions = np.array([[0, 0, 0], [0.1, 0.2, 0.3], [0.2, 0.4, 0.6]], np.float32)
    positions[2] = positions[1] * 2
    for eye in meshes.eyes(20, orthographic=5):
        assert front_facing(positions, np.array([[0, 1, 2]], np.int32), eye)[0]


def test_an_eye_on_the_plane_is_in_front_of_it():
    positions, faces, _ = meshes.normalised(meshes.cube())
    top = positions[:, 2].max()
    eye = np.array([0.1, 0.2, float(top), 1.0])
    on_top = np.all(positions[faces][:, :, 2] == top, axis=1)
    assert front_facing(positions, faces, eye)[on_top].all()
    flipped = np.ascontiguousarray(faces[:, ::-1])
    assert front_facing(positions, flipped, eye)[on_top].all()


finite32 = st.floats(width=32, allow_nan=False, allow_infinity=False)
finite64 = st.floats(allow_nan=False, allow_infinity=False)
corner, place = st.tuples(finite32, finite32, finite32), st.tuples(finite64, finite64, finite64)


@settings(max_examples=400, deadline=None)
@given(corner, corner, corner, place, st.sampled_from([0.0, 1.0]))
def test_orientation_is_the_rational_one_for_all_finite_numbers(a, b, c, p, w):
    corners = [np.array(x, np.float32) for x in (a, b, c)]
    assert orient_sign(*corners, *p, w) == oracles.orientation(*corners, (*p, w))


@njit
def _orient_signs(corners, eyes):
    signs = np.empty(len(corners), np.int8)
    for i in range(len(corners)):
        signs[i] = orient_sign(corners[i, 0], corners[i, 1], corners[i, 2], eyes[i, 0], eyes[i, 1], eyes[i, 2], eyes[i, 3])
    return signs


@pytest.mark.parametrize("family", degenerate.FAMILIES, ids=lambda family: family.__name__)
@settings(max_examples=3, deadline=None)
@given(st.integers(0, 2**32))
def test_orientation_is_the_rational_one_near_degeneracy(family, seed):
    corners, eyes = family(np.random.default_rng(seed), 4000)
    np.testing.assert_array_equal(_orient_signs(corners, eyes), oracles_integer.orientations(corners, eyes))


@settings(max_examples=300, deadline=None)
@given(point, point, st.tuples(grid, grid), st.floats(0.0, 1.0), st.integers(-3, 3), st.sampled_from([0.0, 1.0]))
def test_orientation_is_exact_for_corners_of_all_digits(a, b, eye, part, ulps, w):
    """As where a ray starts at a rounded point of the side from a to b: a float64 that no float32 is."""
    a, b = (np.array(x, np.float64) for x in (a, b))
    p = a + part / 3.0 * (b - a)
    for _ in range(abs(ulps)):
        p[1] = np.nextafter(p[1], np.inf * ulps)
    e = (*eye, 3.7)
    expected = oracles.orientation(p, a, b, (*e, w))
    assert orient_sign(p, a, b, *e, w) == orient_sign(tuple(p.tolist()), tuple(a.tolist()), tuple(b.tolist()), *e, w) == expected


@pytest.mark.parametrize("family", degenerate.FAMILIES, ids=lambda family: family.__name__)
def test_whole_numbers_give_the_rational_sign(family):
    corners, eyes = family(np.random.default_rng(11), 200)
    expected = [oracles.orientation(*three, eye) for three, eye in zip(corners, eyes, strict=True)]
    np.testing.assert_array_equal(oracles_integer.orientations(corners, eyes), expected)


HUGE, TINY = np.finfo(np.float64).max, 5e-324


@settings(max_examples=40, deadline=None)
@given(eye_cases.strategy(), st.sampled_from([1.0, 1e-12, 1e12]))
def test_facing_in_whole_numbers_is_the_rational_one(eye, scale):
    positions, faces = meshes.cube(2)
    positions = (positions * scale).astype(np.float32)
    for place in (eye, np.append(positions[5].astype(np.float64), 1.0)):
        assert np.array_equal(oracles_integer.Facing(positions, faces).front(place), oracles.facing(positions, faces, place))


@pytest.mark.parametrize("eye", [(HUGE, TINY, 0.1), (-1e300, 1e12, 2.0**-600), (2.0**996, 2.0**-1074, 2.0**970), (HUGE, HUGE, -HUGE)])
@pytest.mark.parametrize("w", [0.0, 1.0])
def test_orientation_neither_overflows_nor_underflows(eye, w):
    a, b, c = (np.array(x, np.float32) for x in ((0.5, 3.4e38, 0.5), (-1.0, 1.1754944e-38, 1.5), (0.0, -1.4e-45, 3.4e38)))
    for corners in ((a, b, c), (b, a, c), (a / 2, b / 2, c / 2)):
        assert orient_sign(*corners, *eye, w) == oracles.orientation(*corners, (*eye, w))


def test_facing_of_the_largest_and_smallest_triangles_is_exact():
    corners, eyes = degenerate.all_sizes(np.random.default_rng(2), 500)
    for three, eye in zip(corners, eyes, strict=True):
        expected = oracles.orientation(*three, eye) >= 0
        assert front_facing(three, np.array([[0, 1, 2]], np.int32), eye)[0] == expected


@settings(max_examples=300, deadline=None)
@given(st.lists(finite64, min_size=6, max_size=6), st.booleans())
def test_orientation_in_the_plane_is_the_rational_one_for_all_finite_numbers(values, same):
    if same:
        values[4:] = values[:2]
    assert orient2d_sign(*values) == oracles_integer.orientations_2d([values])[0]


def test_orientation_in_the_plane_is_exact_within_a_few_roundings_of_the_line():
    points = degenerate.lines_2d(np.random.default_rng(4), 6000)
    expected = oracles_integer.orientations_2d(points)
    assert [orient2d_sign(*row.ravel()) for row in points] == expected.tolist()
    for (a, b, p), sign in zip(points[:300].tolist(), expected, strict=False):
        ax, ay, bx, by, px, py = (Fraction(x) for x in (*a, *b, *p))
        left, right = (bx - ax) * (py - ay), (by - ay) * (px - ax)
        assert sign == (left > right) - (left < right)
