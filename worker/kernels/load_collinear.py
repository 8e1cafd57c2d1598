"""Which faces have no area, decided exactly."""

from __future__ import annotations

import numpy as np
from numba import njit

from geometry.predicates import orient2d_sign


@njit(cache=True)
def shadow_sign(a, b, c, axis):
    """Exact sign of component `axis` of (b - a) x (c - a), all (3,): that of the area of the triangle's shadow along the axis."""
    i, j = (axis + 1) % 3, (axis + 2) % 3
    return orient2d_sign(np.float64(a[i]), np.float64(a[j]), np.float64(b[i]), np.float64(b[j]), np.float64(c[i]), np.float64(c[j]))


@njit(cache=True)
def on_one_line(a, b, c):
    """Whether three points (3,) lie on one line."""
    return shadow_sign(a, b, c, 0) == 0 and shadow_sign(a, b, c, 1) == 0 and shadow_sign(a, b, c, 2) == 0


@njit(cache=True)
def collinear(positions, faces):
    """(f,) bool: whether the corners of each face lie on one line. positions (v, 3) f4, faces (f, 3)."""
    flat = np.zeros(len(faces), np.bool_)
    for f in range(len(faces)):
        flat[f] = on_one_line(positions[faces[f, 0]], positions[faces[f, 1]], positions[faces[f, 2]])
    return flat
