"""Where points land in the image, all at once."""

from __future__ import annotations

import numpy as np
from numba import njit

NOTHING, SOME, UNKNOWN = 0, 1, 2


@njit(cache=True, nogil=True)
def screen_bounds(matrix, points, width, height, border):
    """(kind, x0, y0, x1, y1): bounds in pixels, row 0 at the top, of points (n, 3) through matrix (4, 4) f8.

    kind: NOTHING when the convex hull of the points is beyond one side of the image by more than `border` pixels, or behind
    the eye; UNKNOWN when it reaches behind the eye; otherwise SOME, and only then the bounds are meant.
    """
    x0, y0, x1, y1 = np.inf, np.inf, -np.inf, -np.inf
    margin_x, margin_y = 1.0 + 2.0 * border / width, 1.0 + 2.0 * border / height
    left = right = below = above = behind = True
    all_before = True
    for i in range(points.shape[0]):
        px, py, pz = np.float64(points[i, 0]), np.float64(points[i, 1]), np.float64(points[i, 2])
        x = matrix[0, 0] * px + matrix[0, 1] * py + matrix[0, 2] * pz + matrix[0, 3]
        y = matrix[1, 0] * px + matrix[1, 1] * py + matrix[1, 2] * pz + matrix[1, 3]
        w = matrix[3, 0] * px + matrix[3, 1] * py + matrix[3, 2] * pz + matrix[3, 3]
        left &= x < -margin_x * w
        right &= x > margin_x * w
        below &= y < -margin_y * w
        above &= y > margin_y * w
        behind &= w <= 0.0
        if w <= 0.0:
            all_before = False
            continue
        x0, x1 = min(x0, x / w), max(x1, x / w)
        y0, y1 = min(y0, y / w), max(y1, y / w)
    if left or right or below or above or behind:
        return NOTHING, 0.0, 0.0, 0.0, 0.0
    if not all_before:
        return UNKNOWN, 0.0, 0.0, 0.0, 0.0
    return SOME, (x0 + 1.0) * 0.5 * width, (1.0 - y1) * 0.5 * height, (x1 + 1.0) * 0.5 * width, (1.0 - y0) * 0.5 * height
