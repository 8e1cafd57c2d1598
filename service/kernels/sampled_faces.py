"""Which of some faces can have the middle of a pixel in them: of small ones seen nearly edge-on, few do."""

from __future__ import annotations

import numpy as np
from numba import njit

LARGE_PX = np.float32(6.0)
"""Target pixels: faces that are larger than this hold one as a rule, and are not tested."""
MARGIN_PX = np.float32(1.0 / 128.0)
"""Target pixels by which a face may be elsewhere in the GL, which places it in float32 and snaps it to a part of a pixel."""


@njit(cache=True, nogil=True)
def place_vertices(matrix, positions, placed):
    """Fill placed (2, v) f4 with where vertices (v, 3) f4 are in a target; NaN for those that are not before the eye.

    matrix: (4, 4) f8 from positions to homogeneous target pixels.
    """
    xa, xb, xc, xd = matrix[0, 0], matrix[0, 1], matrix[0, 2], matrix[0, 3]
    ya, yb, yc, yd = matrix[1, 0], matrix[1, 1], matrix[1, 2], matrix[1, 3]
    wa, wb, wc, wd = matrix[3, 0], matrix[3, 1], matrix[3, 2], matrix[3, 3]
    for v in range(positions.shape[0]):
        a, b, c = np.float64(positions[v, 0]), np.float64(positions[v, 1]), np.float64(positions[v, 2])
        w = wa * a + wb * b + wc * c + wd
        inverse = 1.0 / w if w > 0.0 else np.nan
        placed[0, v] = (xa * a + xb * b + xc * c + xd) * inverse
        placed[1, v] = (ya * a + yb * b + yc * c + yd) * inverse


@njit(cache=True, nogil=True)
def sampled_faces(placed, size, faces, chosen, kept):
    """Numbers of faces among chosen (n,) i4 that can hold the middle of a target pixel, into kept (n,) i4; their count.

    placed: `place_vertices`. size: (2,) f4 of the target, pixels. Faces that reach behind the eye are kept.
    """
    x, y = placed[0], placed[1]
    count = 0
    for i in range(chosen.shape[0]):
        f = chosen[i]
        a, b, c = np.uint32(faces[f, 0]), np.uint32(faces[f, 1]), np.uint32(faces[f, 2])
        ax, ay, bx, by, cx, cy = x[a], y[a], x[b], y[b], x[c], y[c]
        x0, x1 = min(ax, bx, cx) - MARGIN_PX, max(ax, bx, cx) + MARGIN_PX
        y0, y1 = min(ay, by, cy) - MARGIN_PX, max(ay, by, cy) + MARGIN_PX
        kept[count] = f
        if np.isnan(ax + bx + cx):
            count += 1
        elif not (x1 < 0 or y1 < 0 or x0 > size[0] or y0 > size[1]):
            small = x1 - x0 <= LARGE_PX and y1 - y0 <= LARGE_PX
            count += not small or _holds_middle(x0, x1, y0, y1, ax, ay, bx, by, cx, cy)
    return count


@njit(cache=True, nogil=True)
def _holds_middle(x0, x1, y0, y1, ax, ay, bx, by, cx, cy):
    """Whether the triangle a b c, made larger by the margin, holds the middle of a pixel; x0 ... y1: its bounds."""
    half, one = np.float32(0.5), np.float32(1.0)
    ux, uy, vx, vy, wx, wy = bx - ax, by - ay, cx - bx, cy - by, ax - cx, ay - cy
    if ux * vy - uy * vx < 0:
        ux, uy, vx, vy, wx, wy = -ux, -uy, -vx, -vy, -wx, -wy
    um, vm, wm = -MARGIN_PX * (abs(ux) + abs(uy)), -MARGIN_PX * (abs(vx) + abs(vy)), -MARGIN_PX * (abs(wx) + abs(wy))
    py = np.ceil(y0 - half) + half
    while py <= y1:
        px = np.ceil(x0 - half) + half
        while px <= x1:
            if (ux * (py - ay) - uy * (px - ax) >= um) & (vx * (py - by) - vy * (px - bx) >= vm) & (wx * (py - cy) - wy * (px - cx) >= wm):
                return True
            px += one
        py += one
    return False
