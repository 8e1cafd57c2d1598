"""The covered part of single pixels that several chains cross: area where the winding number is positive.

Between neighbouring heights of interest (ends and crossings of pieces) a pixel is a stack of slabs in which the pieces are
straight and do not meet, so the covered width is linear in y: its value at the middle of the slab, times the height, is
the area exactly. Pixels with more than EXACT_PIECES pieces are cut into SLABS slabs of equal height instead.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from service.kernels.coverage import DOUBTFUL

EXACT_PIECES = 12
SLABS = 32
LONGEST_INSERTION = 48  # longer lists are sorted by argsort


@njit(cache=True, nogil=True, inline="always")
def _insert(heights, n, y):
    """Put y into the sorted heights unless it is there; returns how many there are now."""
    j = n
    while j > 0 and heights[j - 1] > y:
        j -= 1
    if j > 0 and heights[j - 1] == y:
        return n
    for i in range(n, j, -1):
        heights[i] = heights[i - 1]
    heights[j] = y
    return n + 1


@njit(cache=True, nogil=True)
def _heights(p, begin, end, top, heights):
    """Heights of interest of pieces p[begin:end], sorted, each once; returns how many."""
    heights[0], heights[1] = top, top + 1.0
    n = 2
    for i in range(begin, end):
        n = _insert(heights, n, p[i, 1])
        n = _insert(heights, n, p[i, 3])
        dx, dy = p[i, 2] - p[i, 0], p[i, 3] - p[i, 1]
        for j in range(begin, i):
            # the side of i's line that j's ends are on, and the other way round
            first = dx * (p[j, 1] - p[i, 1]) - dy * (p[j, 0] - p[i, 0])
            second = dx * (p[j, 3] - p[i, 1]) - dy * (p[j, 2] - p[i, 0])
            if first * second >= 0.0:
                continue
            ex, ey = p[j, 2] - p[j, 0], p[j, 3] - p[j, 1]
            third = ex * (p[i, 1] - p[j, 1]) - ey * (p[i, 0] - p[j, 0])
            fourth = ex * (p[i, 3] - p[j, 1]) - ey * (p[i, 2] - p[j, 0])
            if third * fourth < 0.0:
                n = _insert(heights, n, p[i, 1] + dy * (third / (third - fourth)))
    return n


@njit(cache=True, nogil=True, inline="always")
def _corner_winding(p, begin, end, total, left, top):
    """Winding number just left of the pixel's top left corner: what is left of the pixel's sum without its own pieces."""
    own = 0.0
    for i in range(begin, end):
        own += (p[i, 3] - p[i, 1]) * (1.0 - 0.5 * ((p[i, 0] - left) + (p[i, 2] - left)))
        if p[i, 0] == left:
            own -= 1.0 - (p[i, 1] - top)
        if p[i, 2] == left:
            own += 1.0 - (p[i, 3] - top)
    return np.floor(total - own + 0.5)


@njit(cache=True, nogil=True, inline="always")
def _sort(at, rise, n):
    if n > LONGEST_INSERTION:
        order = np.argsort(at[:n])
        at[:n] = at[:n][order]
        rise[:n] = rise[:n][order]
        return
    for i in range(1, n):
        x, s, j = at[i], rise[i], i
        while j > 0 and at[j - 1] > x:
            at[j], rise[j] = at[j - 1], rise[j - 1]
            j -= 1
        at[j], rise[j] = x, s


@njit(cache=True, nogil=True)
def _width(p, begin, end, y, corner, left, slope, at, rise):
    """Covered width on the line y. slope: dx / dy of each piece; at, rise: room for the crossings."""
    winding, n = corner, 0
    for i in range(begin, end):
        xa, ya, xb, yb = p[i, 0], p[i, 1], p[i, 2], p[i, 3]
        # a chain that comes in through the left side runs to the right: below it the winding is less by one
        if xa == left and ya < y:
            winding -= 1.0
        if xb == left and yb < y:
            winding += 1.0
        if (ya < y) != (yb < y):
            at[n] = min(max(xa + (y - ya) * slope[i - begin], left), left + 1.0)
            rise[n] = 1.0 if yb > ya else -1.0
            n += 1
    _sort(at, rise, n)
    covered, x = 0.0, left
    for i in range(n):
        if winding > 0.0:
            covered += at[i] - x
        winding += rise[i]
        x = at[i]
    return covered + (left + 1.0 - x if winding > 0.0 else 0.0)


@njit(cache=True, nogil=True)
def covered_area(p, begin, end, total, left, top, scratch):
    """Area of the pixel (left, top) in which the winding number is positive.

    p[begin:end] (k, 4) f8: its pieces. total: the integral of the winding number over the pixel. scratch: (4, n) f8, n at
    least k and at least 2 + 2 m + m^2 with m = min(k, EXACT_PIECES).
    """
    heights, slope, at, rise = scratch[0], scratch[1], scratch[2], scratch[3]
    corner = _corner_winding(p, begin, end, total, left, top)
    for i in range(begin, end):
        drop = p[i, 3] - p[i, 1]
        slope[i - begin] = (p[i, 2] - p[i, 0]) / drop if drop != 0.0 else 0.0
    area = 0.0
    if end - begin > EXACT_PIECES:
        for i in range(SLABS):
            area += _width(p, begin, end, top + (i + 0.5) / SLABS, corner, left, slope, at, rise)
        return area / SLABS
    n = _heights(p, begin, end, top, heights)
    for i in range(n - 1):
        y = 0.5 * (heights[i] + heights[i + 1])
        area += _width(p, begin, end, y, corner, left, slope, at, rise) * (heights[i + 1] - heights[i])
    return area


@njit(cache=True, nogil=True)
def gather(pieces, pixels, x0, y0, state, doubtful, number):
    """(pieces (k, 4) f8 in order of the pixels, offsets (d + 1,)): the pieces of each doubtful pixel.

    doubtful (d,): row * columns + column, relative to (x0, y0). number: scratch of the size of state.
    """
    columns = state.shape[1]
    offsets = np.zeros(doubtful.shape[0] + 1, np.int64)
    for d in range(doubtful.shape[0]):
        number[doubtful[d]] = d
    owner = np.empty(pieces.shape[0], np.int32)
    for i in range(pieces.shape[0]):
        row, column = pixels[i, 0] - y0, pixels[i, 1] - x0
        owner[i] = -1
        if state[row, column] == DOUBTFUL and pieces[i, 0] >= pixels[i, 1]:
            owner[i] = number[row * columns + column]
            offsets[owner[i] + 1] += 1
    for d in range(doubtful.shape[0]):
        offsets[d + 1] += offsets[d]
    cursor = offsets[:-1].copy()
    out = np.empty((offsets[-1], 4))
    for i in range(pieces.shape[0]):
        if owner[i] >= 0:
            place = cursor[owner[i]]
            out[place, 0], out[place, 1], out[place, 2], out[place, 3] = pieces[i, 0], pieces[i, 1], pieces[i, 2], pieces[i, 3]
            cursor[owner[i]] += 1
    return out, offsets


@njit(cache=True, nogil=True)
def resolve(pieces, offsets, doubtful, sums, columns, mask, x0, y0):
    """Replace the mask of every doubtful pixel by its covered area. sums: flat, `columns` numbers a row."""
    most = np.int64(1)
    for d in range(doubtful.shape[0]):
        most = max(most, offsets[d + 1] - offsets[d])
    few = min(most, EXACT_PIECES)
    scratch = np.empty((4, max(most, 2 + 2 * few + few * few)))
    for d in range(doubtful.shape[0]):
        row, column = doubtful[d] // columns, doubtful[d] % columns
        left, top = np.float64(x0 + column), np.float64(y0 + row)
        area = covered_area(pieces, offsets[d], offsets[d + 1], sums[doubtful[d]], left, top, scratch)
        mask[y0 + row, x0 + column] = np.uint8(min(max(area, 0.0), 1.0) * 255.0 + 0.5)
