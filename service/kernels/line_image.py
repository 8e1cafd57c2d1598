"""Segments in space as segments in an image: projected, clipped at the eye plane and at the image's border."""

from __future__ import annotations

import numpy as np
from numba import njit

from service.kernels.clip import EYE_PLANE

X0, Y0, X1, Y1, NEAR0, NEAR1, T0, T1, W0, W1 = 0, 1, 2, 3, 4, 5, 6, 7, 8, 9
"""Columns of a clipped segment: its ends in pixels (y down), how near these are to the eye (linear in the image), which part of the
segment they are the ends of (0 to 1), and their w."""
COLUMNS = 10


@njit(cache=True, inline="always")
def _row(m, i, x, y, z):
    return m[i, 0] * x + m[i, 1] * y + m[i, 2] * z + m[i, 3]


@njit(cache=True, nogil=True)
def _clip(ua, va, wa, ub, vb, wb, width, height):
    """(low, high): the part of a segment, 0 to 1, that is before the eye plane and over the image; low >= high where there is none."""
    low, high = 0.0, 1.0
    for side in range(5):
        if side == 0:
            da, db = wa - EYE_PLANE, wb - EYE_PLANE
        elif side == 1:
            da, db = ua, ub
        elif side == 2:
            da, db = width * wa - ua, width * wb - ub
        elif side == 3:
            da, db = va, vb
        else:
            da, db = height * wa - va, height * wb - vb
        if da < 0.0 and db < 0.0:
            return 1.0, 0.0
        if da < 0.0:
            low = max(low, da / (da - db))
        elif db < 0.0:
            high = min(high, da / (da - db))
    return low, high


@njit(cache=True, nogil=True)
def project_segments(m, away, orthographic, ends, width, height):
    """(image (n, COLUMNS) f8, kept (n,) i4): the segments that can be seen in the image, and which they are.

    m (3, 4) f8: homogeneous pixels; away (4,) f8: depth along the axis, for an orthographic eye; ends (s, 6) f8 both ends in space.
    """
    image, kept = np.empty((ends.shape[0], COLUMNS)), np.empty(ends.shape[0], np.int32)
    count = 0
    for s in range(ends.shape[0]):
        xa, ya, za, xb, yb, zb = ends[s, 0], ends[s, 1], ends[s, 2], ends[s, 3], ends[s, 4], ends[s, 5]
        ua, va, wa = _row(m, 0, xa, ya, za), _row(m, 1, xa, ya, za), _row(m, 2, xa, ya, za)
        ub, vb, wb = _row(m, 0, xb, yb, zb), _row(m, 1, xb, yb, zb), _row(m, 2, xb, yb, zb)
        low, high = _clip(ua, va, wa, ub, vb, wb, width, height)
        if low >= high:
            continue
        for end in range(2):
            t = high if end else low
            # the ends themselves, not what rounding makes of them: segments of one vertex end in one place
            u, v, w = (
                (ua, va, wa) if t == 0.0 else ((ub, vb, wb) if t == 1.0 else (ua + t * (ub - ua), va + t * (vb - va), wa + t * (wb - wa)))
            )
            image[count, X0 + 2 * end] = min(max(u / w, 0.0), width)
            image[count, Y0 + 2 * end] = min(max(v / w, 0.0), height)
            if orthographic:
                x, y, z = (xa, ya, za) if t == 0.0 else (xa + t * (xb - xa), ya + t * (yb - ya), za + t * (zb - za))
                image[count, NEAR0 + end] = -(away[0] * x + away[1] * y + away[2] * z + away[3])
            else:
                image[count, NEAR0 + end] = 1.0 / w
            image[count, T0 + end], image[count, W0 + end] = t, w
        kept[count] = s
        count += 1
    return image[:count].copy(), kept[:count].copy()


@njit(cache=True, nogil=True)
def along(image, n, s):
    """The part of the segment in space, 0 to 1, at part s of clipped segment n in the image."""
    w0, w1 = image[n, W0], image[n, W1]
    part = s * w0 / (w1 * (1.0 - s) + s * w0)
    return image[n, T0] + part * (image[n, T1] - image[n, T0])


@njit(cache=True, nogil=True)
def across(image, n, t):
    """The part of clipped segment n in the image, 0 to 1, at part t of the segment in space: `along` the other way round."""
    w0, w1 = image[n, W0], image[n, W1]
    part = (t - image[n, T0]) / (image[n, T1] - image[n, T0])
    return part * w1 / (w0 * (1.0 - part) + part * w1)
