"""Polylines of an image as a hand draws them: points along them, what their width follows, a wobble, dashes.

The wobble moves every point of the image by a noise of where it is (Perlin 1985, An image synthesizer; here values at the points of a
lattice, smoothly interpolated), not of how far along its line: lines that meet go on meeting, and closed ones have no seam.
The lattice's values are unit vectors made by integers and arithmetic that IEEE 754 says, so that a seed gives the same lines everywhere.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

DEPTH, CURVATURE, ANGLE = 0, 1, 2
"""What strengths follow."""
REACH_PX = 12.0
"""How far from a point on both sides its line's turn is looked at; less of a shorter line, which counts as much less curved."""
FULL_TURN = math.pi / 6.0
"""The turn, radians, of what is most curved."""
NIB_REACH_PX = 4.0
"""How far from a point on both sides the line's direction is looked at."""
SECOND_PART = 0.3
"""Part of the wobble that has half the length."""
GOLDEN, MIX_ONE, MIX_TWO = np.uint64(0x9E3779B97F4A7C15), np.uint64(0xBF58476D1CE4E5B9), np.uint64(0x94D049BB133111EB)
S30, S27, S31, S11 = np.uint64(30), np.uint64(27), np.uint64(31), np.uint64(11)
ONE, TWO = np.uint64(1), np.uint64(2)
SHORTEST = 1e-6
"""Pixels: a dash or gap that is left over and shorter is none."""


@njit(cache=True, nogil=True)
def resample(points, depths, starts, closed, step):
    """(places (m, 3) f8: x, y and depth, at (m,) f8: way along the line, starts (l + 1,) i4, lengths (l,) f8), pixels.

    The points (n, 2) f8 of polylines and more between them, none farther than `step` from the next. Polyline i is
    points[starts[i]:starts[i + 1]]; of closed (l,) bool ones the last point joins the first.
    """
    count = points.shape[0]
    pieces = np.zeros(count, np.int64)
    sizes = np.zeros(count)
    for i in range(closed.shape[0]):
        first, last = starts[i], starts[i + 1]
        for k in range(first, last if closed[i] else last - 1):
            j = k + 1 if k + 1 < last else first
            sizes[k] = math.hypot(points[j, 0] - points[k, 0], points[j, 1] - points[k, 1])
            pieces[k] = max(1, math.ceil(sizes[k] / step))
    total = pieces.sum() + closed.shape[0]
    places, at = np.empty((total, 3)), np.empty(total)
    out, lengths, n = np.zeros(starts.shape[0], np.int32), np.zeros(closed.shape[0]), 0
    for i in range(closed.shape[0]):
        first, last, way = starts[i], starts[i + 1], 0.0
        for k in range(first, last):
            j = k + 1 if k + 1 < last else first
            for part in range(max(pieces[k], 1)):
                t = part / max(pieces[k], 1)
                places[n, 0], places[n, 1] = (
                    points[k, 0] + t * (points[j, 0] - points[k, 0]),
                    points[k, 1] + t * (points[j, 1] - points[k, 1]),
                )
                places[n, 2], at[n] = depths[k] + t * (depths[j] - depths[k]), way + t * sizes[k]
                n += 1
            way += sizes[k]
        lengths[i], out[i + 1] = way, n
    return places[:n].copy(), at[:n].copy(), out, lengths


@njit(cache=True, nogil=True)
def _place(places, at, first, last, closed, length, way):
    """The point of a polyline, rows first to last, that is so far along it; round and round a closed one, at an end beyond the ends."""
    if closed:
        way -= math.floor(way / length) * length
    low, high = first, last - 1
    while low < high:
        middle = (low + high + 1) // 2
        if at[middle] <= way:
            low = middle
        else:
            high = middle - 1
    after, end = (low + 1, at[low + 1]) if low + 1 < last else ((first, length) if closed else (low, at[low]))
    t = min(max((way - at[low]) / (end - at[low]), 0.0), 1.0) if end > at[low] else 0.0
    return places[low, 0] + t * (places[after, 0] - places[low, 0]), places[low, 1] + t * (places[after, 1] - places[low, 1])


@njit(cache=True, nogil=True)
def strengths(follows, places, at, starts, closed, lengths, nearest, farthest, nib):
    """(m,) f8, 0 to 1: how strong a stroke is at the points of `resample`. follows: DEPTH, CURVATURE or ANGLE.

    nearest, farthest: depths with the strengths 1 and 0. nib: direction of the pen, radians from x towards the top of the image.
    """
    out = np.empty(at.shape[0])
    across_x, across_y = math.sin(nib), math.cos(nib)  # perpendicular to the nib, y down
    for i in range(closed.shape[0]):
        first, last, loop, length = starts[i], starts[i + 1], closed[i], lengths[i]
        for k in range(first, last):
            if follows == DEPTH:
                range_ = farthest - nearest
                out[k] = min(max((farthest - places[k, 2]) / range_, 0.0), 1.0) if range_ > 0.0 else 1.0
                continue
            if length <= 0.0:
                out[k] = 0.0
                continue
            reach = min(REACH_PX if follows == CURVATURE else NIB_REACH_PX, 0.25 * length if loop else 0.5 * length)
            middle = at[k] if loop else min(max(at[k], reach), length - reach)
            ax, ay = _place(places, at, first, last, loop, length, middle - reach)
            cx, cy = _place(places, at, first, last, loop, length, middle + reach)
            if follows == ANGLE:
                size = math.hypot(cx - ax, cy - ay)
                out[k] = min(abs(across_x * (cx - ax) + across_y * (cy - ay)) / size, 1.0) if size > 0.0 else 0.0
                continue
            bx, by = _place(places, at, first, last, loop, length, middle)
            cross, dot = (bx - ax) * (cy - by) - (by - ay) * (cx - bx), (bx - ax) * (cx - bx) + (by - ay) * (cy - by)
            out[k] = min(abs(math.atan2(cross, dot)) / FULL_TURN * reach / REACH_PX, 1.0)
    return out


@njit(cache=True, nogil=True)
def _mixed(x):
    """Bits of a 64-bit number stirred (Steele, Lea and Flood 2014, SplitMix)."""
    x = (x ^ (x >> S30)) * MIX_ONE
    x = (x ^ (x >> S27)) * MIX_TWO
    return x ^ (x >> S31)


@njit(cache=True, nogil=True)
def _unit(key, i, j):
    """The unit vector at a point of a lattice: a rational point of a quarter of the circle, turned."""
    bits = _mixed(_mixed(key + np.uint64(i) * GOLDEN) + np.uint64(j) * GOLDEN)
    t = np.float64(bits >> S11) / 9007199254740992.0
    below = 1.0 + t * t
    x, y = (1.0 - t * t) / below, 2.0 * t / below
    if bits & ONE:
        x, y = -y, x
    if bits & TWO:
        x, y = -x, -y
    return x, y


@njit(cache=True, nogil=True)
def _sway(key, x, y):
    """Noise (x, y) of at most 1 at a place, with a lattice of side 1."""
    i, j = math.floor(x), math.floor(y)
    u, v = x - i, y - j
    u, v = u * u * u * (u * (6.0 * u - 15.0) + 10.0), v * v * v * (v * (6.0 * v - 15.0) + 10.0)
    column, row = np.int64(i), np.int64(j)
    ax, ay = _unit(key, column, row)
    bx, by = _unit(key, column + 1, row)
    cx, cy = _unit(key, column, row + 1)
    dx, dy = _unit(key, column + 1, row + 1)
    ax, ay, cx, cy = ax + u * (bx - ax), ay + u * (by - ay), cx + u * (dx - cx), cy + u * (dy - cy)
    return ax + v * (cx - ax), ay + v * (cy - ay)


@njit(cache=True, nogil=True)
def wobble(points, seed, reach, length):
    """Move points (m, 2 or more) f8, x and y first, by at most `reach` pixels, by noise whose lattice has the side `length`."""
    key = _mixed(np.uint64(seed) + GOLDEN)
    other = _mixed(key + GOLDEN)
    for k in range(points.shape[0]):
        x, y = points[k, 0] / length, points[k, 1] / length
        ax, ay = _sway(key, x, y)
        bx, by = _sway(other, 2.0 * x, 2.0 * y)
        points[k, 0] += reach * ((1.0 - SECOND_PART) * ax + SECOND_PART * bx)
        points[k, 1] += reach * ((1.0 - SECOND_PART) * ay + SECOND_PART * by)


@njit(cache=True, nogil=True)
def _length(rows, first, last, closed):
    total = 0.0
    for k in range(first, last if closed else last - 1):
        j = k + 1 if k + 1 < last else first
        total += math.hypot(rows[j, 0] - rows[k, 0], rows[j, 1] - rows[k, 1])
    return total


@njit(cache=True, nogil=True)
def _between(rows, a, b, t, out, n):
    for c in range(rows.shape[1]):
        out[n, c] = rows[a, c] + t * (rows[b, c] - rows[a, c])


@njit(cache=True, nogil=True)
def dashes(rows, starts, closed, pattern):
    """(rows (k, c) f8, starts (d + 1,) i4, of (d,) i4): the dashes of polylines, open ones, and which polyline each is of.

    rows (m, c) f8: x and y in pixels, and whatever else is linear along the lines. pattern (p,) f8, p even: dash, gap, ... in pixels. On
    a closed polyline a whole number of patterns goes round, the nearest to the one asked for.
    """
    period, most_pieces = pattern.sum(), 0
    for i in range(closed.shape[0]):
        most_pieces += (int(_length(rows, starts[i], starts[i + 1], closed[i]) / period) + 2) * (pattern.shape[0] // 2)
    out = np.empty((rows.shape[0] + closed.shape[0] + 2 * most_pieces, rows.shape[1]))
    ends, of = np.zeros(most_pieces + 1, np.int32), np.empty(most_pieces, np.int32)
    n, count = 0, 0
    for i in range(closed.shape[0]):
        first, last = starts[i], starts[i + 1]
        length = _length(rows, first, last, closed[i])
        scale = length / (period * max(1.0, np.round(length / period))) if closed[i] else 1.0
        turn, left, drawing = 0, pattern[0] * scale, False
        for k in range(first, last if closed[i] else last - 1):
            j = k + 1 if k + 1 < last else first
            size, done = math.hypot(rows[j, 0] - rows[k, 0], rows[j, 1] - rows[k, 1]), 0.0
            while size - done > SHORTEST:
                if turn % 2 == 0 and not drawing:
                    _between(rows, k, j, done / size, out, n)
                    n, drawing = n + 1, True
                way = min(left, size - done)
                done, left = done + way, left - way
                if drawing:
                    _between(rows, k, j, 1.0 if size - done <= SHORTEST else done / size, out, n)
                    n += 1
                if left <= SHORTEST:
                    if drawing:
                        count, drawing = count + 1, False
                        ends[count], of[count - 1] = n, i
                    turn = (turn + 1) % pattern.shape[0]
                    left = pattern[turn] * scale
        if drawing:
            count += 1
            ends[count], of[count - 1] = n, i
    return out[:n].copy(), ends[: count + 1].copy(), of[:count].copy()


@njit(cache=True, nogil=True)
def above(rows, starts, closed, column, least):
    """(rows (k, c) f8, starts (d + 1,) i4, of (d,) i4, closed (d,) bool): the parts of polylines on which a column is at least `least`.

    Arguments as those of `dashes`. A polyline that is so everywhere stays as it is.
    """
    most_pieces = rows.shape[0] + closed.shape[0]
    out = np.empty((3 * rows.shape[0] + 2 * closed.shape[0], rows.shape[1]))
    ends, of, loops = np.zeros(most_pieces + 1, np.int32), np.empty(most_pieces, np.int32), np.zeros(most_pieces, np.bool_)
    n, count = 0, 0
    for i in range(closed.shape[0]):
        first, last = starts[i], starts[i + 1]
        begin = first
        while begin < last and rows[begin, column] >= least:
            begin += 1
        if begin == last:
            out[n : n + last - first] = rows[first:last]
            n, count = n + last - first, count + 1
            ends[count], of[count - 1], loops[count - 1] = n, i, closed[i]
            continue
        if not closed[i]:
            begin = first  # a closed one begins where it is below, so that no part goes over its beginning
        drawing = rows[begin, column] >= least
        if drawing:
            out[n] = rows[begin]
            n += 1
        for step in range(last - first if closed[i] else last - first - 1):
            k = first + (begin - first + step) % (last - first)
            j = first + (begin - first + step + 1) % (last - first)
            a, b = rows[k, column], rows[j, column]
            if (a >= least) != (b >= least):
                _between(rows, k, j, (least - a) / (b - a), out, n)
                n += 1
                drawing = not drawing
                if not drawing:
                    count += 1
                    ends[count], of[count - 1] = n, i
            if drawing:
                out[n] = rows[j]
                n += 1
        if drawing:
            count += 1
            ends[count], of[count - 1] = n, i
    return out[:n].copy(), ends[: count + 1].copy(), of[:count].copy(), loops[:count].copy()
