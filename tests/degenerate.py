"""Families of triangles and eyes whose orientation is hard to tell: (rng, n) -> (corners (n, 3, 3) f4, eyes (n, 4) f8)."""

from __future__ import annotations

import numpy as np


def _triangles(rng, n):
    return rng.normal(size=(n, 3, 3)).astype(np.float32)


def _at(points, w=1.0):
    return np.column_stack([points, np.broadcast_to(w, len(points))])


def _in_plane(rng, corners, reach=2.0):
    """(n, 3) f8 points of the planes, rounded."""
    a, b, c = (corners[:, k].astype(np.float64) for k in range(3))
    s, t = rng.uniform(-reach, reach, (2, len(corners), 1))
    return a + s * (b - a) + t * (c - a)


def nudged(rng, points, most=3):
    """Every coordinate moved by up to `most` ulps."""
    steps = rng.integers(-most, most + 1, points.shape)
    for _ in range(most):
        points = np.where(steps == 0, points, np.nextafter(points, np.copysign(np.inf, steps)))
        steps -= np.sign(steps)
    return points


def anywhere(rng, n):
    """Nothing special, as the eyes of pictures."""
    direction = rng.normal(size=(n, 3))
    direction *= rng.uniform(1.5, 4.0, (n, 1)) / np.linalg.norm(direction, axis=1, keepdims=True)
    return _triangles(rng, n), _at(direction)


def few_ulps_off(rng, n):
    """Eyes within three ulps of the plane in every coordinate."""
    corners = _triangles(rng, n)
    return corners, _at(nudged(rng, _in_plane(rng, corners)))


def coplanar_by_a_coordinate(rng, n):
    """Corners and eye share a coordinate; a quarter of the eyes is an ulp above, a quarter below."""
    corners, eyes = _triangles(rng, n), rng.normal(size=(n, 3))
    axis, rows = rng.integers(0, 3, n), np.arange(n)
    corners[rows, :, axis] = corners[rows, :1, axis]
    shared = corners[rows, 0, axis].astype(np.float64)
    step = rng.integers(-1, 3, n)
    eyes[rows, axis] = np.where(step == 1, np.nextafter(shared, np.inf), np.where(step == -1, np.nextafter(shared, -np.inf), shared))
    return corners, _at(eyes)


def eyes_at_corners(rng, n):
    """Eyes on corners, and on middles of sides, which are exact."""
    corners = _triangles(rng, n)
    rows, k, other = np.arange(n), rng.integers(0, 3, n), rng.integers(0, 3, n)
    return corners, _at(corners[rows, k].astype(np.float64) / 2 + corners[rows, other].astype(np.float64) / 2)


def tiny_and_far(rng, n):
    """Triangles a few float32 steps wide, far from the origin for that; eyes in their planes."""
    centre = rng.uniform(0.5, 1.0, (n, 1, 3))
    corners = (centre + rng.integers(-4, 5, (n, 3, 3)) * 2.0**-24).astype(np.float32)
    return corners, _at(nudged(rng, _in_plane(rng, corners, 1e5), 1))


def needles(rng, n):
    """The third corner is within a rounding of the line through the others; eyes near that line."""
    corners = _triangles(rng, n)
    a, b = corners[:, 0].astype(np.float64), corners[:, 1].astype(np.float64)
    corners[:, 2] = a + rng.uniform(-1.0, 2.0, (n, 1)) * (b - a)
    eyes = a + rng.uniform(-3.0, 3.0, (n, 1)) * (b - a) + rng.normal(size=(n, 3)) * 10.0 ** rng.integers(-16, -3, (n, 1))
    return corners, _at(eyes)


def very_near(rng, n):
    """Eyes 1e-9 to 1e-16 off the middle of the face."""
    corners = _triangles(rng, n)
    eyes = corners.astype(np.float64).mean(axis=1) + rng.normal(size=(n, 3)) * 10.0 ** rng.integers(-16, -8, (n, 1))
    return corners, _at(eyes)


def very_far(rng, n):
    """Eyes in the plane, 1e12 triangles away."""
    corners = _triangles(rng, n)
    return corners, _at(nudged(rng, _in_plane(rng, corners, 1e12), 1))


def at_infinity(rng, n):
    """Directions along the face and along its sides."""
    corners = _triangles(rng, n)
    sides = corners[:, 1:].astype(np.float64) - corners[:, :1]
    weights = rng.integers(-2, 3, (n, 2, 1)) * np.where(rng.random((n, 1, 1)) < 0.5, 1.0, rng.random((n, 2, 1)))
    return corners, _at((weights * sides).sum(axis=1), 0.0)


def denormal(rng, n):
    """Corners of a few of the smallest float32 numbers; eyes of such numbers, and of the smallest float64 ones."""
    corners = (rng.integers(-9, 10, (n, 3, 3)) * 2.0**-149).astype(np.float32)
    unit = np.where(rng.random((n, 1)) < 0.5, 2.0**-149, 2.0**-1074)
    return corners, _at(rng.integers(-9, 10, (n, 3)) * unit, rng.integers(0, 2, n).astype(np.float64))


def _powers(rng, shape, low, high):
    return np.ldexp(rng.integers(-1, 2, shape).astype(np.float64), rng.integers(low, high, shape))


def powers_of_two(rng, n):
    """Zeros and powers of two of all sizes, corners and eyes."""
    w = rng.integers(0, 2, n).astype(np.float64)
    return _powers(rng, (n, 3, 3), -149, 128).astype(np.float32), _at(_powers(rng, (n, 3), -1074, 1024), w)


def all_sizes(rng, n):
    """Corners and eyes of any exponent; half of the eyes are within an ulp of a plane through the origin."""
    corners = np.ldexp(rng.uniform(-1, 1, (n, 3, 3)), rng.integers(-140, 128, (n, 1, 3))).astype(np.float32)
    half = rng.random(n) < 0.5
    corners[half, 0] = 0.0
    inside = np.ldexp(rng.integers(-3, 4, (n, 2, 1)).astype(np.float64) * corners[:, 1:], rng.integers(-900, 880, (n, 1, 1))).sum(axis=1)
    inside = nudged(rng, inside, 1)
    eyes = np.where(half[:, None], inside, np.ldexp(rng.uniform(-1, 1, (n, 3)), rng.integers(-1070, 1024, (n, 3))))
    return corners, _at(eyes)


def grid(rng, n):
    """Everything on a coarse grid: exact zeros, coinciding points, triangles without area."""
    corners = (rng.integers(-3, 4, (n, 3, 3)) / 8).astype(np.float32)
    return corners, _at(rng.integers(-3, 4, (n, 3)) / 8, rng.integers(0, 2, n).astype(np.float64))


FAMILIES = (
    anywhere, few_ulps_off, coplanar_by_a_coordinate, eyes_at_corners, tiny_and_far, needles, very_near, very_far, at_infinity,
    denormal, powers_of_two, all_sizes, grid,
)  # fmt: skip
"""All of them; `anywhere` is the only one that is not hard."""


def lines_2d(rng, n):
    """(n, 3, 2) f8: two points and one within a few ulps of their line; every third row of wild exponents."""
    points = rng.normal(size=(n, 3, 2))
    points[:, 2] = points[:, 0] + rng.uniform(-2, 2, (n, 1)) * (points[:, 1] - points[:, 0])
    points[:, 2] = nudged(rng, points[:, 2])
    points[::3] = _powers(rng, points[::3].shape, -1074, 1024)
    return points
