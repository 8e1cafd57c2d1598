"""Polylines with fewer points and rounder corners, within a distance from what they were.

Simplifying is that of Douglas and Peucker 1973: the point farthest from the chord stays, and so on on both sides of it, until none is
farther than the tolerance. Smoothing replaces corners by parabolas that touch the sides, as Chaikin's cutting of corners (1974) does in
the limit, each so near to its corner that it stays within the tolerance.
"""

from __future__ import annotations

import numpy as np
from numba import njit

STEPS = 4
"""Chords of a rounded corner."""


@njit(cache=True, nogil=True)
def _distance2(points, i, a, b):
    """Squared distance of point i from the segment between points a and b."""
    dx, dy = points[b, 0] - points[a, 0], points[b, 1] - points[a, 1]
    x, y = points[i, 0] - points[a, 0], points[i, 1] - points[a, 1]
    square = dx * dx + dy * dy
    t = min(1.0, max(0.0, (x * dx + y * dy) / square)) if square > 0.0 else 0.0
    return (x - t * dx) ** 2 + (y - t * dy) ** 2


@njit(cache=True, nogil=True)
def _keep_between(points, first, last, tolerance2, keep, stack):
    """Mark in keep which points between first and last stay; stack (n, 2) i4: scratch."""
    stack[0, 0], stack[0, 1], top = first, last, 1
    while top > 0:
        top -= 1
        a, b = stack[top, 0], stack[top, 1]
        far, most = -1, tolerance2
        for i in range(a + 1, b):
            square = _distance2(points, i, a, b)
            if square > most:
                far, most = i, square
        if far >= 0:
            keep[far] = True
            stack[top, 0], stack[top, 1], stack[top + 1, 0], stack[top + 1, 1] = a, far, far, b
            top += 2


@njit(cache=True, nogil=True)
def _first_half(points, first, last):
    """Of a closed polyline: the point that is farthest from its first."""
    far, most = first, -1.0
    for i in range(first, last):
        square = (points[i, 0] - points[first, 0]) ** 2 + (points[i, 1] - points[first, 1]) ** 2
        if square > most:
            far, most = i, square
    return far


@njit(cache=True, nogil=True)
def simplify(points, starts, closed, tolerance):
    """(n,) bool: which points (n, 2 or more) f8 of polylines stay, so that none is farther than `tolerance` from the line of those that do.

    Polyline i is points[starts[i]:starts[i + 1]]; of closed (l,) bool ones the last point joins the first.
    """
    keep, square = np.zeros(points.shape[0], np.bool_), tolerance * tolerance
    longest = 2
    for i in range(closed.shape[0]):
        longest = max(longest, starts[i + 1] - starts[i] + 2)
    stack, loop = np.empty((longest, 2), np.int64), np.empty((longest, 2))
    for i in range(closed.shape[0]):
        first, last = starts[i], starts[i + 1]
        count = last - first
        if count <= 2:
            keep[first:last] = True
            continue
        loop[:count] = points[first:last, :2]
        loop[count] = points[first, :2]  # the last side of a closed one ends where it began
        end, kept = count if closed[i] else count - 1, np.zeros(count + 1, np.bool_)
        kept[0], kept[end] = True, True
        middle = _first_half(loop, 0, count) if closed[i] else 0
        kept[middle] = True
        if middle > 0:
            _keep_between(loop, 0, middle, square, kept, stack)
        _keep_between(loop, middle, end, square, kept, stack)
        for k in range(count):
            keep[first + k] = kept[k]
    return keep


@njit(cache=True, nogil=True)
def _round_corner(points, before, corner, after, tolerance, out, n):
    """Append the parabola of a corner to out; returns the new n."""
    px, py = points[corner, 0], points[corner, 1]
    ax, ay = 0.5 * (points[before, 0] - px), 0.5 * (points[before, 1] - py)
    bx, by = 0.5 * (points[after, 0] - px), 0.5 * (points[after, 1] - py)
    # the parabola is nearest to its corner by a quarter of a + b, or less where the sides are unlike
    depth = 0.25 * np.hypot(ax + bx, ay + by)
    scale = 1.0 if depth <= tolerance else tolerance / depth
    for k in range(STEPS + 1):
        t = k / STEPS
        start, end = scale * (1.0 - t) * (1.0 - t), scale * t * t
        out[n, 0], out[n, 1] = px + start * ax + end * bx, py + start * ay + end * by
        for c in range(2, points.shape[1]):
            value = points[corner, c]
            out[n, c] = value + 0.5 * (start * (points[before, c] - value) + end * (points[after, c] - value))
        n += 1
    return n


@njit(cache=True, nogil=True)
def smooth(points, starts, closed, tolerance):
    """(rounded (m, k) f8, starts (l + 1,) i4): polylines with their corners rounded, nowhere farther than `tolerance` from the corners.

    Arguments as those of `simplify`, points (n, k) with what is linear along the lines in further columns; the ends of open polylines stay.
    """
    out = np.empty((points.shape[0] * (STEPS + 1), points.shape[1]))
    ends, n = np.zeros(starts.shape[0], np.int32), 0
    for i in range(closed.shape[0]):
        first, last = starts[i], starts[i + 1]
        for k in range(first, last):
            is_end = not closed[i] and (k == first or k == last - 1)
            if is_end or last - first < 3:
                out[n] = points[k]
                n += 1
            else:
                before, after = (k - 1 if k > first else last - 1), (k + 1 if k < last - 1 else first)
                n = _round_corner(points, before, k, after, tolerance, out, n)
        ends[i + 1] = n
    return out[:n].copy(), ends
