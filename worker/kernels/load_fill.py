"""Least-area triangulation of a boundary loop in space.

Based on: Barequet and Sharir, "Filling Gaps in the Boundary of a Polyhedron" (1995), section 4: dynamic programming over the
sub-loops, O(n^3). Chords that the mesh already has as edges are forbidden, and needles cost extra.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

NEEDLE = 1e-7
"""Twice the area by the square of the longest side below which a triangle is a needle."""
NEEDLE_COST = 1e6
"""More than the area of any triangle in the unit sphere."""


@njit(cache=True)
def _cost(p, i, j, k):
    """Area of the triangle, and much more when it is a needle."""
    ux, uy, uz = p[j, 0] - p[i, 0], p[j, 1] - p[i, 1], p[j, 2] - p[i, 2]
    vx, vy, vz = p[k, 0] - p[i, 0], p[k, 1] - p[i, 1], p[k, 2] - p[i, 2]
    wx, wy, wz = vx - ux, vy - uy, vz - uz
    x, y, z = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    twice = math.sqrt(x * x + y * y + z * z)
    longest = max(ux * ux + uy * uy + uz * uz, vx * vx + vy * vy + vz * vz, wx * wx + wy * wy + wz * wz)
    return twice / 2.0 + (NEEDLE_COST if twice <= NEEDLE * longest else 0.0)


@njit(cache=True)
def triangulate_loop(p, taken):
    """((n - 2, 3) i8 corners in the loop's own direction, total area), or no rows where every way uses a taken chord.

    p (n, 3) f8 in order around the loop; taken (n, n) bool: chords that are edges of the mesh already.
    """
    n = len(p)
    best = np.full((n, n), np.inf)
    apex = np.full((n, n), -1, np.int64)
    for i in range(n - 1):
        best[i, i + 1] = 0.0
    for span in range(2, n):
        for i in range(n - span):
            j = i + span
            if span < n - 1 and taken[i, j]:
                continue
            for m in range(i + 1, j):
                if math.isinf(best[i, m]) or math.isinf(best[m, j]):
                    continue
                c = best[i, m] + best[m, j] + _cost(p, i, m, j)
                if c < best[i, j]:
                    best[i, j], apex[i, j] = c, m
    if math.isinf(best[0, n - 1]):
        return np.empty((0, 3), np.int64), 0.0
    triangles = np.empty((n - 2, 3), np.int64)
    stack = [(0, n - 1)]
    area, k = 0.0, 0
    while len(stack) > 0:
        i, j = stack.pop()
        if j - i < 2:
            continue
        m = apex[i, j]
        triangles[k, 0], triangles[k, 1], triangles[k, 2] = i, m, j
        cost = _cost(p, i, m, j)
        area += cost - NEEDLE_COST if cost >= NEEDLE_COST else cost
        k += 1
        stack.append((i, m))
        stack.append((m, j))
    return triangles, area
