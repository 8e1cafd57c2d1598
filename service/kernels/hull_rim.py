"""Places in the map for pixels that the outline touches although their centre lies beside the hull.

A pixel whose square meets the original while its centre lies outside the hull is at most half a diagonal from the hull's
outline, so all pixels within LEAST_HALF_WIDTH of its silhouette edges get a place on the nearest of them. It is written
as one more row of planes an edge, beside those of the faces, and lies behind everything (`hull_visible`).
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from geometry.borrowing import borrowing
from service.kernels.hull_visible import FACE_BITS

LEAST_HALF_WIDTH = 1.0  # pixels; sqrt(1/2) would do, the rest is for rounding
NEAREST = (1 << 62) - (1 << 61) // 8  # word of a pixel on an edge: behind every face, before nothing at all
DISTANCE_UNIT = float(1 << 30)  # steps of a squared half width


@borrowing
def _corner(faces, f, vertex):
    """Which corner of face f the vertex is."""
    return 0 if faces[f, 0] == vertex else (1 if faces[f, 1] == vertex else 2)


@borrowing
def _along(points, a, b):
    """(first, last) parameter along a -> b of what the near plane leaves; first > last when that is nothing."""
    near_a, near_b = points[a, 2] + points[a, 3], points[b, 2] + points[b, 3]
    if near_a < 0.0 and near_b < 0.0:
        return 1.0, 0.0
    first = near_a / (near_a - near_b) if near_a < 0.0 else 0.0
    last = near_a / (near_a - near_b) if near_b < 0.0 else 1.0
    return first, last


@borrowing
def _pixel(points, a, b, t):
    w = points[a, 3] + t * (points[b, 3] - points[a, 3])
    return (points[a, 0] + t * (points[b, 0] - points[a, 0])) / w, (points[a, 1] + t * (points[b, 1] - points[a, 1])) / w


@borrowing
def _cover(px, py, qx, qy, half, number, x0, y0, x1, y1, words):
    """Put an edge into the words of the pixels within half pixels of it, where it is the nearest."""
    dx, dy = qx - px, qy - py
    square = dx * dx + dy * dy
    scale = 1.0 / square if square > 0.0 else 0.0
    unit = DISTANCE_UNIT / (half * half)
    top, bottom = max(min(py, qy) - half, y0 - 1.0), min(max(py, qy) + half, y1 + 1.0)
    if not top <= bottom:
        return
    for row in range(max(np.int64(math.floor(top)), y0), min(np.int64(math.floor(bottom)) + 1, y1)):
        y = row + 0.5
        # where the edge runs while it is near this row
        first, last = 0.0, 1.0
        if dy != 0.0:
            s, t = (y - half - py) / dy, (y + half - py) / dy
            first, last = max(first, min(s, t)), min(last, max(s, t))
        if first > last:
            continue
        xa, xb = px + first * dx, px + last * dx
        low, high = max(min(xa, xb) - half, x0 - 1.0), min(max(xa, xb) + half, x1 + 1.0)
        for column in range(max(np.int64(math.floor(low)), x0), min(np.int64(math.floor(high)) + 1, x1)):
            if words[row - y0, column - x0] < NEAREST:
                continue
            x = column + 0.5
            t = min(max(((x - px) * dx + (y - py) * dy) * scale, 0.0), 1.0)
            ex, ey = x - px - t * dx, y - py - t * dy
            away = ex * ex + ey * ey
            if away <= half * half:
                word = NEAREST + ((np.int64(away * unit) << FACE_BITS) | number)
                words[row - y0, column - x0] = min(words[row - y0, column - x0], word)


@borrowing
def _lay_out(px, py, qx, qy, half, ua, va, ub, vb, plane):
    """Planes of the place in the map: from one end to the other over a length that is half pixels longer at both."""
    dx, dy = qx - px, qy - py
    length = math.sqrt(dx * dx + dy * dy)
    if length > 0.0:
        dx, dy = dx / length, dy / length
    scale = 1.0 / (length + 2.0 * half)
    start = (half - px * dx - py * dy) * scale
    plane[0], plane[1], plane[2] = (ub - ua) * dx * scale, (ub - ua) * dy * scale, ua + (ub - ua) * start
    plane[3], plane[4], plane[5] = (vb - va) * dx * scale, (vb - va) * dy * scale, va + (vb - va) * start
    plane[6], plane[7], plane[8] = 0.0, 0.0, 1.0


@njit(cache=True, nogil=True, error_model="numpy")
def place_rim(points, faces, uv, edge_vertices, edge_faces, front, ends, places):
    """The hull's silhouette edges in the image: returns n, their ends in ends[:n] (n, 4) f8 pixels, and in places[:n] (n, 4) f8 where in
    the map these are, texels.

    edge_vertices, edge_faces (e, 2) i4: the hull's edges. front (f,) bool. Edges behind the near plane are left out, others cut at it.
    """
    n = 0
    for e in range(edge_vertices.shape[0]):
        f, other = edge_faces[e, 0], edge_faces[e, 1]
        if front[f] == front[other]:
            continue
        f = f if front[f] else other
        a, b = edge_vertices[e, 0], edge_vertices[e, 1]
        first, last = _along(points, a, b)
        if first > last:
            continue
        ends[n, 0], ends[n, 1] = _pixel(points, a, b, first)
        ends[n, 2], ends[n, 3] = _pixel(points, a, b, last)
        i, j = _corner(faces, f, a), _corner(faces, f, b)
        for k in range(2):
            along = uv[f, j, k] - uv[f, i, k]
            places[n, k], places[n, 2 + k] = uv[f, i, k] + first * along, uv[f, i, k] + last * along
        n += 1
    return n


@borrowing
def draw_rim(ends, places, half, faces, x0, y0, x1, y1, words, planes):
    """Draw the rim into words, as `hull_visible.draw_faces` left them, and its planes behind those of the `faces` faces.

    ends, places (n, 4) f8: of `place_rim`. half: pixels. planes (faces + n, PLANES) f8.
    """
    for e in range(ends.shape[0]):
        px, py, qx, qy = ends[e, 0], ends[e, 1], ends[e, 2], ends[e, 3]
        if not (min(py, qy) - half <= y1 and max(py, qy) + half >= y0):
            continue
        number = faces + e
        _lay_out(px, py, qx, qy, half, places[e, 0], places[e, 1], places[e, 2], places[e, 3], planes[number])
        _cover(px, py, qx, qy, half, number, x0, y0, x1, y1, words)
