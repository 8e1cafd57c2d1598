"""A plane between two convex bodies, each given by points of which it is the convex hull.

This work is based on: Gilbert, Johnson, Keerthi 1988, A fast procedure for computing the distance between complex objects.
Departures: it stops at the first plane that separates, not at the distance; the nearest point of a simplex is the best over all
of its faces, each by its normal equations, so that no order of tests can lose it. What is found is checked on the points: a plane
that is returned separates whatever rounding did on the way to it.
"""

from __future__ import annotations

import numpy as np
from numba import njit

MOST_STEPS = 64
CLEAR = 1e-12
"""Least gap, in units of the bodies' size (which is about one): far above the rounding of a dot product."""
OUTSIDE = -1e-12
"""Least weight of a simplex's corner at which a point still counts as on the simplex."""


@njit(cache=True, nogil=True)
def shrunk(points, part):
    """Points (n, 3) f8, moved towards their mean by this part of the way."""
    n = points.shape[0]
    mean = np.zeros(3)
    for i in range(n):
        for k in range(3):
            mean[k] += points[i, k] / n
    out = np.empty((n, 3))
    for i in range(n):
        for k in range(3):
            out[i, k] = points[i, k] + part * (mean[k] - points[i, k])
    return out


@njit(cache=True, nogil=True)
def separating_plane(a, b, plane):
    """Whether the convex hulls of a (n, 3) f8 and b (m, 3) f8 are certainly apart; plane (4,) f8 is set to one between them.

    Then n . p < d for all p of a and n . p > d for all p of b, with plane = (n, d), n unit. False: they meet, or nearly do.
    """
    simplex = np.empty((4, 3))
    nearest = np.zeros(3)  # of the differences b - a to the origin, so far
    for k in range(3):
        nearest[k] = b[0, k] - a[0, k]
    count = 0
    for _ in range(MOST_STEPS):
        length = np.sqrt(nearest[0] ** 2 + nearest[1] ** 2 + nearest[2] ** 2)
        if not length > CLEAR:
            return False
        x, y, z = nearest[0] / length, nearest[1] / length, nearest[2] / length
        i, high = _farthest(a, x, y, z)
        j, low = _farthest(b, -x, -y, -z)
        low = -low
        if low - high > CLEAR:
            plane[0], plane[1], plane[2], plane[3] = x, y, z, 0.5 * (low + high)
            return True
        if count > 0 and low - high > length * (1.0 - 1e-10):
            return False  # no point of the difference is nearer, and this one is not far enough
        if count == 4:
            return False
        for k in range(3):
            simplex[count, k] = b[j, k] - a[i, k]
        count = _nearest_on(simplex, count + 1, nearest)
    return False


@njit(cache=True, nogil=True)
def _farthest(points, x, y, z):
    """(index, distance) of the point farthest along a direction."""
    best, at = -np.inf, 0
    for i in range(points.shape[0]):
        s = points[i, 0] * x + points[i, 1] * y + points[i, 2] * z
        if s > best:
            best, at = s, i
    return at, best


@njit(cache=True, nogil=True)
def _nearest_on(simplex, count, nearest):
    """Set `nearest` to the point of the simplex of `count` corners nearest to the origin; keep only the corners it needs.

    The newest corner, the last, is one of them. Returns how many are kept.
    """
    best, best_mask = np.inf, 0
    weight = np.empty(4)
    point = np.empty(3)
    for mask in range(1, 1 << count):
        if not mask >> (count - 1) & 1 or not _weights(simplex, count, mask, weight):
            continue
        for k in range(3):
            point[k] = 0.0
            for i in range(count):
                if mask >> i & 1:
                    point[k] += weight[i] * simplex[i, k]
        square = point[0] ** 2 + point[1] ** 2 + point[2] ** 2
        if square < best:
            best, best_mask = square, mask
            nearest[:] = point
    kept = 0
    for i in range(count):
        if best_mask >> i & 1:
            simplex[kept] = simplex[i]
            kept += 1
    return kept


@njit(cache=True, nogil=True)
def _weights(simplex, count, mask, weight):
    """Barycentric weights of the origin's projection on the span of the corners in `mask`; False when it is not inside them.

    Normal equations over the edges from the newest corner p: (e_r . e_c) t_c = -e_r . p.
    """
    last = count - 1
    others = np.empty(3, np.int64)
    n = 0
    for i in range(last):
        if mask >> i & 1:
            others[n] = i
            n += 1
    m = np.zeros((3, 4))
    for r in range(n):
        for k in range(3):
            er = simplex[others[r], k] - simplex[last, k]
            for c in range(n):
                m[r, c] += er * (simplex[others[c], k] - simplex[last, k])
            m[r, 3] -= er * simplex[last, k]
    for p in range(n):  # symmetric and positive: elimination needs no exchanges of rows
        if not m[p, p] > 0.0:
            return False
        for r in range(n):
            if r != p:
                f = m[r, p] / m[p, p]
                for c in range(p, n):
                    m[r, c] -= f * m[p, c]
                m[r, 3] -= f * m[p, 3]
    rest = 1.0
    for r in range(n):
        t = m[r, 3] / m[r, r]
        if not t >= OUTSIDE:
            return False
        weight[others[r]] = t
        rest -= t
    weight[last] = rest
    return rest >= OUTSIDE
