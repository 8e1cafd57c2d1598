"""How often a closed surface winds around a point."""

from __future__ import annotations

import math

import numpy as np
from numba import njit


@njit(cache=True)
def winding_number(p, faces, point):
    """Sum of the solid angles of (f, 3) faces seen from `point`, in whole turns; an integer up to rounding off the surface.

    Solid angle by van Oosterom and Strackee, "The Solid Angle of a Plane Triangle" (1983).
    """
    total = 0.0
    u = np.empty((3, 3))
    length = np.empty(3)
    for f in range(len(faces)):
        for k in range(3):
            for axis in range(3):
                u[k, axis] = p[faces[f, k], axis] - point[axis]
            length[k] = math.sqrt(u[k, 0] ** 2 + u[k, 1] ** 2 + u[k, 2] ** 2)
        volume = (
            u[0, 0] * (u[1, 1] * u[2, 2] - u[1, 2] * u[2, 1])
            + u[0, 1] * (u[1, 2] * u[2, 0] - u[1, 0] * u[2, 2])
            + u[0, 2] * (u[1, 0] * u[2, 1] - u[1, 1] * u[2, 0])
        )
        d01 = u[0, 0] * u[1, 0] + u[0, 1] * u[1, 1] + u[0, 2] * u[1, 2]
        d12 = u[1, 0] * u[2, 0] + u[1, 1] * u[2, 1] + u[1, 2] * u[2, 2]
        d20 = u[2, 0] * u[0, 0] + u[2, 1] * u[0, 1] + u[2, 2] * u[0, 2]
        total += math.atan2(volume, length[0] * length[1] * length[2] + d01 * length[2] + d12 * length[0] + d20 * length[1])
    return total / (2.0 * math.pi)
