"""Whether a point lies outside the convex hull of others."""

from __future__ import annotations

import numpy as np
from numba import njit

MOST_STEPS = 200


@njit(cache=True, nogil=True)
def is_separated(points, eye):
    """Whether a plane through `eye` (3,) f8 has all `points` (n, 3) f4 strictly on one side. False when none was found.

    The direction starts towards the origin and is improved as in Gilbert's algorithm for the convex hull's closest point;
    True is certain up to the rounding of one dot product, which `margin` covers; False may be wrong for an eye that nearly
    touches the convex hull.
    """
    margin = 1e-12
    cx, cy, cz = -eye[0], -eye[1], -eye[2]
    for _ in range(MOST_STEPS):
        least = np.inf
        support = -1
        for i in range(points.shape[0]):
            d = cx * (points[i, 0] - eye[0]) + cy * (points[i, 1] - eye[1]) + cz * (points[i, 2] - eye[2])
            if d < least:
                least = d
                support = i
        length2 = cx * cx + cy * cy + cz * cz
        if least > margin * max(1.0, np.sqrt(length2)):
            return True
        if support < 0 or length2 < 1e-24:
            return False
        # closest point to the eye on the segment from the closest point so far to the support point
        sx, sy, sz = points[support, 0] - eye[0] - cx, points[support, 1] - eye[1] - cy, points[support, 2] - eye[2] - cz
        step2 = sx * sx + sy * sy + sz * sz
        if step2 == 0.0:
            return False
        t = min(1.0, max(0.0, -(cx * sx + cy * sy + cz * sz) / step2))
        if t == 0.0:
            return False
        cx, cy, cz = cx + t * sx, cy + t * sy, cz + t * sz
    return False
