import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from geometry import expansions as ex
from geometry.predicates import front_facing, orient_sign
from tests import meshes, oracles

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


doubles = st.floats(-1e6, 1e6, allow_subnormal=False).filter(lambda x: x == 0 or abs(x) > 1e-30)


@settings(max_examples=200, deadline=None)
@given(st.lists(doubles, min_size=1, max_size=12))
def test_sums_of_expansions_have_the_exact_sign(values):
    e = np.empty(len(values) + 1)
    n = 0
    for v in values:
        n = ex.grow(e, n, v)
    exact = sum(oracles._rational(values))
    assert ex.sign(e, n) == (exact > 0) - (exact < 0)
    assert sum(oracles._rational(e[:n])) == exact


@settings(max_examples=200, deadline=None)
@given(doubles, doubles, doubles, doubles)
def test_products_of_expansions_are_exact(a, b, c, d):
    e, n = ex.difference(a, b)
    f, m = ex.difference(c, d)
    out = np.empty(8)
    k = ex.multiply(e, n, f, m, out)
    a, b, c, d = oracles._rational((a, b, c, d))
    assert sum(oracles._rational(out[:k])) == (a - b) * (c - d)
