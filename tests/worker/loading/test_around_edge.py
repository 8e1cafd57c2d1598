"""The order of faces around an edge, where doubles cannot tell on which side of the edge a needle lies."""

import numpy as np
import pytest

from tests import oracles_integer
from worker.kernels.load_around_edge import sort_around

# (a, b, q) in the plane z = 0, in units of 2^-34: det[b - a, q - a] is -1 or 1 of 2^68, and the double made of it is zero
NEEDLES = [
    ((11828245, 12017508), (16599315456, 9465917440), (15997663, 14393833), -1),
    ((15392291, 11486317), (12824940544, 10662170624), (16382735, 12309836), -1),
    ((10548504, 10220653), (12509281280, 12113042432), (11735677, 11370221), 1),
    ((14840834, 11787187), (10285351936, 10768100352), (15960501, 12959815), 1),
]


@pytest.mark.parametrize(("a", "b", "q", "side"), NEEDLES)
def test_a_needle_lies_on_its_own_side_of_the_edge(a, b, q, side):
    points = np.array([a, b, q], np.float64) * 2.0**-34
    assert np.array_equal(points, points.astype(np.float32)) and oracles_integer.orientations_2d([points]) == side
    (ux, uy), (vx, vy) = points[1] - points[0], points[2] - points[0]
    assert ux * vy - uy * vx == 0.0
    # left and right of the edge in its plane, and over and below it
    along = points[1] - points[0]
    middle, across = points[:2].mean(axis=0), np.array([-along[1], along[0]])
    left, right = middle + across, middle - across
    corners = [*points, left, right, middle, middle]
    p = np.zeros((7, 3), np.float32)
    p[:, :2], p[5, 2], p[6, 2] = corners, 1.0, -1.0
    needle, left, right, over, below = 2, 3, 4, 5, 6
    reference, opposite = (right, needle) if side > 0 else (left, needle)
    faces = np.array([[0, 1, apex] for apex in (reference, opposite, over, below)])
    members = np.array([0, 3, 6, 9])
    sort_around(p, faces, np.ones(12, np.bool_), members)
    apexes = [int(faces[h // 3, 2]) for h in members]
    assert apexes == ([right, below, needle, over] if side > 0 else [left, over, needle, below])
