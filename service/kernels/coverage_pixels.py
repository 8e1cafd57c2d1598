"""The covered part of single pixels that several chains cross: area where the winding number is positive.

Between neighbouring heights of interest (ends and crossings of pieces) a pixel is a stack of slabs in which the pieces are
straight and do not meet, so the covered width is linear in y: its value at the middle of the slab, times the height, is
the area exactly. Pixels with more than EXACT_PIECES pieces are cut into SLABS slabs of equal height instead.
"""

from __future__ import annotations

import numpy as np
from numba import njit

EXACT_PIECES = 12
SLABS = 32
LEFTMOST_INSERTION = 48  # longer lists are sorted by argsort


@njit(cache=True, nogil=True)
def _heights(p, top, out):
    """Heights of interest of pieces p (k, 4), sorted, within the row; returns how many."""
    out[0], out[1] = top, top + 1.0
    n = 2
    for i in range(p.shape[0]):
        out[n], out[n + 1] = p[i, 1], p[i, 3]
        n += 2
        for j in range(i):
            dx, dy = p[i, 2] - p[i, 0], p[i, 3] - p[i, 1]
            ex, ey = p[j, 2] - p[j, 0], p[j, 3] - p[j, 1]
            area = dx * ey - dy * ex
            if area == 0.0:
                continue
            t = ((p[j, 0] - p[i, 0]) * ey - (p[j, 1] - p[i, 1]) * ex) / area
            u = ((p[j, 0] - p[i, 0]) * dy - (p[j, 1] - p[i, 1]) * dx) / area
            if 0.0 < t < 1.0 and 0.0 < u < 1.0:
                out[n] = p[i, 1] + t * dy
                n += 1
    for i in range(1, n):
        value, j = out[i], i
        while j > 0 and out[j - 1] > value:
            out[j] = out[j - 1]
            j -= 1
        out[j] = value
    return n


@njit(cache=True, nogil=True)
def _corner_winding(p, total, left, top):
    """Winding number just left of the pixel's top left corner: what is left of the pixel's sum without its own pieces."""
    own = 0.0
    for i in range(p.shape[0]):
        own += (p[i, 3] - p[i, 1]) * (1.0 - 0.5 * ((p[i, 0] - left) + (p[i, 2] - left)))
        if p[i, 0] == left:
            own -= 1.0 - (p[i, 1] - top)
        if p[i, 2] == left:
            own += 1.0 - (p[i, 3] - top)
    return np.round(total - own)


@njit(cache=True, nogil=True)
def _width(p, y, corner, left, at, sign):
    """Covered width on the line y; at, sign (k,): room for the crossings."""
    winding, n = corner, 0
    for i in range(p.shape[0]):
        xa, ya, xb, yb = p[i, 0], p[i, 1], p[i, 2], p[i, 3]
        # a chain that comes in through the left side runs to the right: below it the winding is less by one
        if xa == left and ya < y:
            winding -= 1.0
        if xb == left and yb < y:
            winding += 1.0
        if (ya < y) != (yb < y):
            x = xa + (y - ya) * ((xb - xa) / (yb - ya))
            at[n] = min(max(x, left), left + 1.0)
            sign[n] = 1.0 if yb > ya else -1.0
            n += 1
    _sort(at, sign, n)
    covered, x = 0.0, left
    for i in range(n):
        if winding > 0.0:
            covered += at[i] - x
        winding += sign[i]
        x = at[i]
    return covered + (left + 1.0 - x if winding > 0.0 else 0.0)


@njit(cache=True, nogil=True)
def _sort(at, sign, n):
    if n > LEFTMOST_INSERTION:
        order = np.argsort(at[:n])
        at[:n] = at[:n][order]
        sign[:n] = sign[:n][order]
        return
    for i in range(1, n):
        x, s, j = at[i], sign[i], i
        while j > 0 and at[j - 1] > x:
            at[j], sign[j] = at[j - 1], sign[j - 1]
            j -= 1
        at[j], sign[j] = x, s


@njit(cache=True, nogil=True)
def covered_area(p, total, left, top, heights, at, sign):
    """Area of the pixel (left, top) in which the winding number is positive.

    p (k, 4) f8: its pieces. total: the integral of the winding number over the pixel. heights, at, sign: scratch of at least
    2 + 2 k + k (k - 1) / 2 (for k <= EXACT_PIECES), k and k numbers.
    """
    corner = _corner_winding(p, total, left, top)
    area = 0.0
    if p.shape[0] > EXACT_PIECES:
        for i in range(SLABS):
            area += _width(p, top + (i + 0.5) / SLABS, corner, left, at, sign)
        return area / SLABS
    n = _heights(p, top, heights)
    for i in range(n - 1):
        if heights[i + 1] > heights[i]:
            y = 0.5 * (heights[i] + heights[i + 1])
            area += _width(p, y, corner, left, at, sign) * (heights[i + 1] - heights[i])
    return area


@njit(cache=True, nogil=True)
def gather(pieces, cells, state, doubtful, number):
    """(sorted pieces (k, 4) f8, offsets (d + 1,)): the pieces of each doubtful pixel. state: flat, with DOUBTFUL = 255."""
    offsets = np.zeros(doubtful.shape[0] + 1, np.int64)
    for d in range(doubtful.shape[0]):
        number[doubtful[d]] = d
    for i in range(cells.shape[0]):
        if state[cells[i]] == 255:
            offsets[number[cells[i]] + 1] += 1
    for d in range(doubtful.shape[0]):
        offsets[d + 1] += offsets[d]
    cursor = offsets[:-1].copy()
    out = np.empty((offsets[-1], 4))
    for i in range(cells.shape[0]):
        if state[cells[i]] == 255:
            d = number[cells[i]]
            for k in range(4):
                out[cursor[d], k] = pieces[i, k]
            cursor[d] += 1
    return out, offsets


@njit(cache=True, nogil=True)
def resolve(pieces, offsets, doubtful, sums, columns, mask, x0, y0):
    """Replace the mask of every doubtful pixel by its covered area. sums: flat, `columns` numbers a row."""
    most = 1
    for d in range(doubtful.shape[0]):
        most = max(most, offsets[d + 1] - offsets[d])
    few = min(most, EXACT_PIECES)
    heights = np.empty(2 + 2 * few + few * few)
    at, sign = np.empty(most), np.empty(most)
    for d in range(doubtful.shape[0]):
        row, column = doubtful[d] // columns, doubtful[d] % columns
        left, top = np.float64(x0 + column), np.float64(y0 + row)
        area = covered_area(pieces[offsets[d] : offsets[d + 1]], sums[doubtful[d]], left, top, heights, at, sign)
        mask[y0 + row, x0 + column] = np.uint8(min(max(area, 0.0), 1.0) * 255.0 + 0.5)
