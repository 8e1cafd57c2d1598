"""Cubic pieces of a contour in the image, and the polygons that stand for them."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from service.kernels.clip import EYE_PLANE
from service.kernels.smooth_curves import handle_of

FARTHEST_PX = 1e6
"""Pieces with an end farther out are left straight; nobody sees them."""
MOST_CHORDS = 256


@njit(cache=True, nogil=True)
def _direction(m, x, y, d, chord_x, chord_y, length):
    """Unit direction in the image, along the chord, of the direction d at a point that is seen at (x, y)."""
    w = m[2, 0] * d[0] + m[2, 1] * d[1] + m[2, 2] * d[2]
    a = m[0, 0] * d[0] + m[0, 1] * d[1] + m[0, 2] * d[2] - x * w
    b = m[1, 0] * d[0] + m[1, 1] * d[1] + m[1, 2] * d[2] - y * w
    size = max(abs(a), abs(b))
    if not 0.0 < size < np.inf:
        return chord_x / length, chord_y / length
    a, b = a / size, b / size
    size = math.hypot(a, b)
    if a * chord_x + b * chord_y < 0.0:
        size = -size
    return a / size, b / size


@njit(cache=True, nogil=True)
def _visible(corner):
    w = corner[2]
    return w >= EYE_PLANE and abs(corner[0]) <= FARTHEST_PX * w and abs(corner[1]) <= FARTHEST_PX * w


@njit(cache=True, nogil=True)
def inner_points(m, corners, following, tangents):
    """(k, 2, 2) f8 pixels: the inner control points of the pieces; NaN where an end is behind the eye or far away.

    m (3, 4) pixel matrix, corners (k, 3) f8 nodes (u, v, w), tangents (k, 2, 3) f8 directions in space at the ends.
    """
    out = np.full((corners.shape[0], 2, 2), np.nan)
    for k in range(corners.shape[0]):
        first, last = corners[k], corners[following[k]]
        if not (_visible(first) and _visible(last)):
            continue
        ax, ay = first[0] / first[2], first[1] / first[2]
        bx, by = last[0] / last[2], last[1] / last[2]
        x, y = bx - ax, by - ay
        length = math.hypot(x, y)
        sx, sy, tx, ty = 0.0, 0.0, 0.0, 0.0
        if length > 0.0:
            sx, sy = _direction(m, ax, ay, tangents[k, 0], x, y, length)
            tx, ty = _direction(m, bx, by, tangents[k, 1], x, y, length)
        size = handle_of(sx * tx + sy * ty) * length
        out[k, 0, 0], out[k, 0, 1] = ax + size * sx, ay + size * sy
        out[k, 1, 0], out[k, 1, 1] = bx - size * tx, by - size * ty
    return out


@njit(cache=True, nogil=True)
def _controls(corners, following, inner, k, c):
    """Fill c (4, 2) with the control points of piece k, pixels."""
    first, last = corners[k], corners[following[k]]
    c[0, 0], c[0, 1] = first[0] / first[2], first[1] / first[2]
    c[1], c[2] = inner[k, 0], inner[k, 1]
    c[3, 0], c[3, 1] = last[0] / last[2], last[1] / last[2]


@njit(cache=True, nogil=True)
def _chords(c, width, height, tolerance):
    """How many chords stay within `tolerance` pixels of a cubic (Wang's bound); one for what is beside the image."""
    if max(c[0, 1], c[1, 1], c[2, 1], c[3, 1]) < 0.0 or min(c[0, 1], c[1, 1], c[2, 1], c[3, 1]) > height:
        return 1
    if max(c[0, 0], c[1, 0], c[2, 0], c[3, 0]) < 0.0 or min(c[0, 0], c[1, 0], c[2, 0], c[3, 0]) > width:
        return 1
    bend = 0.0
    for i in range(2):
        x, y = c[i, 0] - 2.0 * c[i + 1, 0] + c[i + 2, 0], c[i, 1] - 2.0 * c[i + 1, 1] + c[i + 2, 1]
        bend = max(bend, math.hypot(x, y))
    return max(1, min(MOST_CHORDS, math.ceil(math.sqrt(0.75 * bend / tolerance))))


@njit(cache=True, nogil=True)
def flatten(corners, offsets, following, inner, width, height, tolerance):
    """(corners (n, 3) f8, offsets (c + 1,) i4): the loops as polygons, of homogeneous corners like the nodes."""
    count = corners.shape[0]
    chords = np.ones(count, np.int64)
    c = np.empty((4, 2))
    for k in range(count):
        if not math.isnan(inner[k, 0, 0]):
            _controls(corners, following, inner, k, c)
            chords[k] = _chords(c, width, height, tolerance)
    out = np.empty((chords.sum(), 3))
    starts = np.zeros(offsets.shape[0], np.int32)
    n = 0
    for loop in range(offsets.shape[0] - 1):
        for k in range(offsets[loop], offsets[loop + 1]):
            out[n] = corners[k]
            n += 1
            if chords[k] == 1:
                continue
            _controls(corners, following, inner, k, c)
            for i in range(1, chords[k]):
                t = i / chords[k]
                s = 1.0 - t
                w = s * corners[k, 2] + t * corners[following[k], 2]
                for axis in range(2):
                    a = s * s * (s * c[0, axis] + 3.0 * t * c[1, axis])
                    out[n, axis] = (a + t * t * (3.0 * s * c[2, axis] + t * c[3, axis])) * w
                out[n, 2] = w
                n += 1
        starts[loop + 1] = n
    return out, starts
