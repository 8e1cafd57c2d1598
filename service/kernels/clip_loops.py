"""Clipping of closed polygons in homogeneous pixels: first at the eye plane, then at a frame about the image.

Cutting a polygon off along a half-plane and joining the cuts along its border leaves the winding number of every point
inside the half-plane as it was (Sutherland and Hodgman's clipping), so contours stay closed and areas stay right.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from service.kernels.clip import EYE_PLANE, closing_path


@njit(cache=True, nogil=True)
def eye_plane_cuts(loop, cuts, k):
    """Append to cuts (n, 3) f8, from k on, (u, v, sign) where a loop (m, 3) f8 of (u, v, w) crosses the eye plane."""
    for i in range(loop.shape[0]):
        j = i + 1 if i + 1 < loop.shape[0] else 0
        if (loop[i, 2] < EYE_PLANE) != (loop[j, 2] < EYE_PLANE):
            t = (EYE_PLANE - loop[i, 2]) / (loop[j, 2] - loop[i, 2])
            cuts[k, 0] = loop[i, 0] + t * (loop[j, 0] - loop[i, 0])
            cuts[k, 1] = loop[i, 1] + t * (loop[j, 1] - loop[i, 1])
            cuts[k, 2] = 1.0 if loop[i, 2] < EYE_PLANE else -1.0
            k += 1
    return k


@njit(cache=True, nogil=True)
def _before_the_eye(loop, width, height, angle, radius):
    """The part of a loop with w >= EYE_PLANE, closed by way of the hub (`service.kernels.clip.hub_of`)."""
    n = loop.shape[0]
    cuts = np.empty((n, 3))
    crossings = eye_plane_cuts(loop, cuts, 0)
    out = np.empty((n + 5 * crossings, 3))
    path = np.empty((5, 2))
    m, k = 0, 0
    for i in range(n):
        j = i + 1 if i + 1 < n else 0
        if loop[i, 2] >= EYE_PLANE:
            out[m] = loop[i]
            m += 1
        if (loop[i, 2] < EYE_PLANE) == (loop[j, 2] < EYE_PLANE):
            continue
        count = closing_path(cuts[k, 0], cuts[k, 1], angle, radius, width, height, path)
        for c in range(count):
            point = c if cuts[k, 2] < 0.0 else count - 1 - c
            out[m, 0], out[m, 1], out[m, 2] = path[point, 0], path[point, 1], EYE_PLANE
            m += 1
        k += 1
    return out[:m]


@njit(cache=True, nogil=True)
def _half_plane(loop, a, b, c):
    """The part of a loop with a u + b v + c w >= 0; w > 0 everywhere."""
    n = loop.shape[0]
    out = np.empty((2 * n, 3))
    m = 0
    for i in range(n):
        j = i + 1 if i + 1 < n else 0
        here = a * loop[i, 0] + b * loop[i, 1] + c * loop[i, 2]
        there = a * loop[j, 0] + b * loop[j, 1] + c * loop[j, 2]
        if here >= 0.0:
            out[m] = loop[i]
            m += 1
        if (here < 0.0) != (there < 0.0):
            out[m] = loop[i] + here / (here - there) * (loop[j] - loop[i])
            m += 1
    return out[:m]


@njit(cache=True, nogil=True)
def clip_loop(loop, width, height, margin, angle, radius):
    """(m, 2) f8 pixels of a closed loop (n, 3) f8 of (u, v, w), within `margin` pixels of the image.

    Inside that frame the winding number is that of the loop's part in front of the eye.
    """
    loop = _before_the_eye(loop, width, height, angle, radius)
    loop = _half_plane(loop, 1.0, 0.0, margin)
    loop = _half_plane(loop, -1.0, 0.0, width + margin)
    loop = _half_plane(loop, 0.0, 1.0, margin)
    loop = _half_plane(loop, 0.0, -1.0, height + margin)
    out = np.empty((loop.shape[0], 2))
    for i in range(loop.shape[0]):
        out[i, 0], out[i, 1] = loop[i, 0] / loop[i, 2], loop[i, 1] / loop[i, 2]
    return out
