"""Least-area triangulation of a boundary loop in space.

Based on: Barequet and Sharir, "Filling Gaps in the Boundary of a Polyhedron" (1995), section 4: dynamic programming over the
sub-loops, O(n^3). Chords that the mesh already has as edges cost extra, as they would get four faces, and so do needles.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

NEEDLE = 1e-7
"""Twice the area by the square of the longest side below which a triangle is a needle."""
FAULT_COST = 1e6
"""Of a needle or a taken chord: more than the area of any patch in the unit sphere."""


@njit(cache=True)
def _area(p, i, j, k):
    """(area of the triangle, whether it is a needle)."""
    ux, uy, uz = p[j, 0] - p[i, 0], p[j, 1] - p[i, 1], p[j, 2] - p[i, 2]
    vx, vy, vz = p[k, 0] - p[i, 0], p[k, 1] - p[i, 1], p[k, 2] - p[i, 2]
    wx, wy, wz = vx - ux, vy - uy, vz - uz
    x, y, z = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    twice = math.sqrt(x * x + y * y + z * z)
    longest = max(ux * ux + uy * uy + uz * uz, vx * vx + vy * vy + vz * vz, wx * wx + wy * wy + wz * wz)
    return twice / 2.0, twice <= NEEDLE * longest


@njit(cache=True)
def triangulate_loop(p, taken):
    """((n - 2, 3) i8 corners in the loop's own direction, total area).

    p (n, 3) f8 in order around the loop, n > 2; taken (n, n) bool: chords that are edges of the mesh already.
    """
    n = len(p)
    best = np.zeros((n, n))
    apex = np.full((n, n), -1, np.int64)
    for span in range(2, n):
        for i in range(n - span):
            j = i + span
            least = np.inf
            for m in range(i + 1, j):
                if best[i, m] + best[m, j] >= least:
                    continue
                area, needle = _area(p, i, m, j)
                cost = best[i, m] + best[m, j] + area + (FAULT_COST if needle else 0.0)
                if cost < least:
                    least, apex[i, j] = cost, m
            best[i, j] = least + (FAULT_COST if span < n - 1 and taken[i, j] else 0.0)
    triangles = np.empty((n - 2, 3), np.int64)
    stack = [(0, n - 1)]
    total, k = 0.0, 0
    while len(stack) > 0:
        i, j = stack.pop()
        if j - i < 2:
            continue
        m = apex[i, j]
        triangles[k, 0], triangles[k, 1], triangles[k, 2] = i, m, j
        total += _area(p, i, m, j)[0]
        k += 1
        stack.append((i, m))
        stack.append((m, j))
    return triangles, total
