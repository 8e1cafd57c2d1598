"""Strokes whose width changes as filled shapes: what two discs and the trapezoid about them cover, along a polyline, and no more.

Every piece of a polyline has a quadrilateral on each side, up to the tangents of the discs at its ends; where two pieces meet, the side
that opens is filled by a fan of the disc. All of these turn the same way, so that their common outline, filled by the nonzero rule,
is their union however sharply the line turns or winds over itself. On the side that closes, the outline goes through the point
of the line itself, which keeps it the sum of the parts:

              a3 --- arc --- b0                     corners of a point on the side that opens: a3 ... b0,
         ____/                 \\____               on the other: a3, the point, b0
    a2                               b1             or, where the line is nearly straight there, one on each side
         the point of the line
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

NEARLY_STRAIGHT = math.cos(math.radians(10.0))
"""Cosine of a turn whose two corners may be one, in the middle: that is off the disc by less than half a hundredth of its radius."""
NEAR_ENOUGH = 0.45
"""Part of a piece's length by which such a corner may move along it: the corners at both ends stay in order."""
STEEPEST = 0.95
"""Most that a radius may change for each pixel of a piece; a disc that is steeper is inside the other one or nearly."""


@njit(cache=True, nogil=True)
def _directions(points, radii, starts, closed):
    """(m, 4) f8: of the piece from each point on: its direction (unit), its length, and how much the radius grows for each pixel of it.

    A piece without length has the direction of the one before.
    """
    out = np.zeros((points.shape[0], 4))
    for i in range(closed.shape[0]):
        first, last = starts[i], starts[i + 1]
        tx, ty = 1.0, 0.0
        for again in range(2):
            for k in range(first, last if closed[i] else last - 1):
                j = k + 1 if k + 1 < last else first
                dx, dy = points[j, 0] - points[k, 0], points[j, 1] - points[k, 1]
                length = math.hypot(dx, dy)
                if length > 0.0:
                    tx, ty = dx / length, dy / length
                    out[k, 3] = min(max((radii[j] - radii[k]) / length, -STEEPEST), STEEPEST)
                out[k, 0], out[k, 1], out[k, 2] = tx, ty, length
            if again == 0 and out[first, 2] > 0.0:
                break
    return out


@njit(cache=True, nogil=True)
def _normal(direction, side):
    """Where the tangent of the discs touches them, from their centres, on a side (1 or -1) of a piece."""
    cosine = math.sqrt(1.0 - direction[3] * direction[3])
    x = -side * direction[1] * cosine - direction[0] * direction[3]
    return x, side * direction[0] * cosine - direction[1] * direction[3]


@njit(cache=True, nogil=True)
def _steps(angle, radius, tolerance):
    """Chords of an arc that are within the tolerance of it."""
    if radius <= tolerance:
        return 1
    return max(1, math.ceil(angle / (2.0 * math.acos(1.0 - tolerance / radius))))


@njit(cache=True, nogil=True)
def _arc(x, y, radius, ax, ay, angle, tolerance, out, n):
    """Append to out the corners of an arc from (ax, ay), a unit vector, over an angle with a sign; returns the new n."""
    steps = _steps(abs(angle), radius, tolerance)
    for k in range(steps + 1):
        c, s = math.cos(angle * k / steps), math.sin(angle * k / steps)
        out[n, 0], out[n, 1] = x + radius * (c * ax - s * ay), y + radius * (s * ax + c * ay)
        n += 1
    return n


@njit(cache=True, nogil=True)
def _join(x, y, radius, before, after, side, tolerance, out, n):
    """Append the corners where two pieces meet, on a side; returns the new n."""
    ax, ay = _normal(before, side)
    bx, by = _normal(after, side)
    cosine = ax * bx + ay * by
    if cosine > NEARLY_STRAIGHT:
        mx, my = (ax + bx) / (1.0 + cosine), (ay + by) / (1.0 + cosine)
        back = radius * abs((mx - ax) * before[0] + (my - ay) * before[1])
        on = radius * abs((mx - bx) * after[0] + (my - by) * after[1])
        room_back, room_on = before[2] * (1.0 - before[3] * before[3]), after[2] * (1.0 - after[3] * after[3])
        if back <= NEAR_ENOUGH * room_back and on <= NEAR_ENOUGH * room_on:
            out[n, 0], out[n, 1] = x + radius * mx, y + radius * my
            return n + 1
    turn = math.atan2(before[0] * after[1] - before[1] * after[0], before[0] * after[0] + before[1] * after[1])
    opening = math.asin(before[3]) - math.asin(after[3]) - side * turn  # more than half a turn about a large disc between small ones
    if opening >= 0.0:
        return _arc(x, y, radius, ax, ay, -side * opening, tolerance, out, n)
    out[n, 0], out[n, 1] = x + radius * ax, y + radius * ay
    out[n + 1, 0], out[n + 1, 1] = x, y
    out[n + 2, 0], out[n + 2, 1] = x + radius * bx, y + radius * by
    return n + 3


@njit(cache=True, nogil=True)
def _cap(x, y, radius, direction, side, at_end, flat, tolerance, out, n):
    """Append the corners of an end, on a side: of half of its round cap, or one straight across; returns the new n."""
    if flat:
        out[n, 0], out[n, 1] = x - side * radius * direction[1], y + side * radius * direction[0]
        return n + 1
    ax, ay = _normal(direction, side)
    if at_end:
        angle = math.atan2(ax * direction[1] - ay * direction[0], ax * direction[0] + ay * direction[1])
        return _arc(x, y, radius, ax, ay, angle, tolerance, out, n)
    tx, ty = -direction[0], -direction[1]
    angle = math.atan2(tx * ay - ty * ax, tx * ax + ty * ay)
    return _arc(x, y, radius, tx, ty, angle, tolerance, out, n)


@njit(cache=True, nogil=True)
def sides(points, radii, starts, closed, flat, tolerance):
    """(corners (k, 2) f8, first (2 m + 1,) i8): corners of the strokes about points (m, 2) f8 with radii (m,) f8, pixels.

    Those of point i on both sides are corners[first[2 i]:first[2 i + 1]] and corners[first[2 i + 1]:first[2 i + 2]], both along the way;
    the first side is where (-y, x) of a direction (x, y) points. Polylines as in `stroke_paths.resample`; flat (l,) bool: those that do
    not end round. tolerance: pixels by which chords may be off their arcs.
    """
    directions = _directions(points, radii, starts, closed)
    largest = 0.0
    for k in range(radii.shape[0]):
        largest = max(largest, radii[k])
    most = _steps(2.0 * math.pi, largest, tolerance) + 3
    corners, first = np.empty((max(1024, 4 * points.shape[0]), 2)), np.zeros(2 * points.shape[0] + 1, np.int64)
    n = 0
    for i in range(closed.shape[0]):
        begin, end = starts[i], starts[i + 1]
        for k in range(begin, end):
            if n + 2 * most > corners.shape[0]:
                more = np.empty((2 * corners.shape[0] + 2 * most, 2))
                more[:n] = corners[:n]
                corners = more
            x, y, radius = points[k, 0], points[k, 1], radii[k]
            for s in range(2):
                side = 1.0 - 2.0 * s
                if not closed[i] and k == begin:
                    n = _cap(x, y, radius, directions[k], side, False, flat[i], tolerance, corners, n)
                elif not closed[i] and k == end - 1:
                    n = _cap(x, y, radius, directions[k - 1], side, True, flat[i], tolerance, corners, n)
                else:
                    before = directions[k - 1 if k > begin else end - 1]
                    n = _join(x, y, radius, before, directions[k], side, tolerance, corners, n)
                first[2 * k + s + 1] = n
    return corners[:n].copy(), first


@njit(cache=True, nogil=True)
def outlines(corners, first, starts, closed):
    """(places (k, 2) f8, offsets (q + 1,) i4): closed polygons to be filled together by the nonzero rule, two of a closed polyline.

    corners, first: `sides`. Polygon i is places[offsets[i]:offsets[i + 1]].
    """
    out, offsets = np.empty_like(corners), np.zeros(2 * closed.shape[0] + 1, np.int32)
    n, count = 0, 0
    for i in range(closed.shape[0]):
        for k in range(starts[i], starts[i + 1]):
            for c in range(first[2 * k], first[2 * k + 1]):
                out[n] = corners[c]
                n += 1
        if closed[i]:
            count += 1
            offsets[count] = n
        for k in range(starts[i + 1] - 1, starts[i] - 1, -1):
            for c in range(first[2 * k + 2] - 1, first[2 * k + 1] - 1, -1):
                out[n] = corners[c]
                n += 1
        count += 1
        offsets[count] = n
    return out[:n].copy(), offsets[: count + 1].copy()


@njit(cache=True, nogil=True)
def _triangle(indices, n, a, b, c):
    indices[n], indices[n + 1], indices[n + 2] = a, b, c
    return n + 3


@njit(cache=True, nogil=True)
def triangles(points, corners, first, starts, closed, depth):
    """(vertices (m + k, 3) f4, indices (3 t,) i4): the same as triangles, the points and then the corners, all at one depth."""
    count = points.shape[0]
    vertices = np.empty((count + corners.shape[0], 3), np.float32)
    for k in range(count):
        vertices[k, 0], vertices[k, 1], vertices[k, 2] = points[k, 0], points[k, 1], depth
    for c in range(corners.shape[0]):
        vertices[count + c, 0], vertices[count + c, 1], vertices[count + c, 2] = corners[c, 0], corners[c, 1], depth
    indices, n = np.empty(3 * (corners.shape[0] + 4 * count), np.int32), 0
    for i in range(closed.shape[0]):
        for k in range(starts[i], starts[i + 1]):
            for s in range(2):
                for c in range(first[2 * k + s], first[2 * k + s + 1] - 1):
                    n = _triangle(indices, n, k, count + c, count + c + 1)
            if k + 1 == starts[i + 1] and not closed[i]:
                continue
            j = k + 1 if k + 1 < starts[i + 1] else starts[i]
            for s in range(2):
                a, b = count + first[2 * k + s + 1] - 1, count + first[2 * j + s]
                n = _triangle(indices, n, k, a, b)
                n = _triangle(indices, n, k, b, j)
    return vertices, indices[:n].copy()
