"""Which faces have no area, decided exactly."""

from __future__ import annotations

import numpy as np
from numba import njit

from geometry import expansions as ex

# two roundings of the differences, one of each product and one of their difference, with room
_ERROR = 8.0 * 2.0**-53
_GUARD = 1e-280


@njit(cache=True)
def _minor_is_zero(a, b, c, i, j):
    """Whether (b - a)_i (c - a)_j - (b - a)_j (c - a)_i is exactly zero."""
    ui, uj = b[i] - a[i], b[j] - a[j]
    vi, vj = c[i] - a[i], c[j] - a[j]
    p, q = ui * vj, uj * vi
    if abs(p - q) > _ERROR * (abs(p) + abs(q)) + _GUARD:
        return False
    eu, nu = ex.difference(b[i], a[i])
    ev, nv = ex.difference(c[j], a[j])
    total = np.empty(16)
    n = ex.multiply(eu, nu, ev, nv, total)
    eu, nu = ex.difference(b[j], a[j])
    ev, nv = ex.difference(c[i], a[i])
    other = np.empty(8)
    m = ex.multiply(eu, nu, ev, nv, other)
    for k in range(m):
        other[k] = -other[k]
    return ex.sign(total, ex.add(total, n, other, m)) == 0


@njit(cache=True)
def collinear(positions, faces):
    """(f,) bool: whether the corners of each face lie on one line. positions (v, 3) f4, faces (f, 3)."""
    flat = np.zeros(len(faces), np.bool_)
    p = np.empty((3, 3))
    for f in range(len(faces)):
        for k in range(3):
            for axis in range(3):
                p[k, axis] = positions[faces[f, k], axis]
        flat[f] = (
            _minor_is_zero(p[0], p[1], p[2], 0, 1) and _minor_is_zero(p[0], p[1], p[2], 1, 2) and _minor_is_zero(p[0], p[1], p[2], 2, 0)
        )
    return flat
