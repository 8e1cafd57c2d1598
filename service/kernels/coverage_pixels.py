"""The covered part of single pixels that several chains cross: area where the winding number is positive.

Most need only a look: where all winding numbers beside pieces are positive the pixel is full; and when no pieces meet, each has
one winding number on its left and one on its right, and those between 0 and 1 are the border of the covered area.
In the others, between neighbouring heights of interest (ends and crossings of pieces), a pixel is a stack of slabs in which
the pieces are straight and do not meet, so the covered width is linear in y: its value at the middle of the slab, times the
height, is the area exactly. Those with more than EXACT_PIECES pieces are cut into SLABS slabs of equal height instead.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from service.kernels.coverage import DOUBTFUL

EXACT_PIECES = 8
SLABS = 20
LONGEST_INSERTION = 48  # longer lists are sorted by argsort
STEEPEST = 1e5  # dx / dy up to which x = a + b y is good to NEAR
NEAR = 1e-9  # pixels


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
def _integral(p, i, left, top):
    """What piece i adds to the integral of the winding number over its pixel, given that just left of the top left corner."""
    own = (p[i, 3] - p[i, 1]) * (1.0 - 0.5 * ((p[i, 0] - left) + (p[i, 2] - left)))
    # a chain that comes in through the left side runs to the right: below it the winding is less by one
    if p[i, 0] == left:
        own -= 1.0 - (p[i, 1] - top)
    if p[i, 2] == left:
        own += 1.0 - (p[i, 3] - top)
    return own


@njit(cache=True, nogil=True, inline="always")
def _corner_winding(p, begin, end, total, left, top):
    """Winding number just left of the pixel's top left corner: what is left of the pixel's sum without its own pieces."""
    own = 0.0
    for i in range(begin, end):
        own += _integral(p, i, left, top)
    return np.floor(total - own + 0.5)


@njit(cache=True, nogil=True)
def _sort(scratch, n):
    """Sort the first n crossings (rows 8 and 9 of scratch) by x."""
    if n > LONGEST_INSERTION:
        order = np.argsort(scratch[8, :n])
        scratch[8, :n] = scratch[8, :n][order]
        scratch[9, :n] = scratch[9, :n][order]
        return
    for i in range(1, n):
        x, s, j = scratch[8, i], scratch[9, i], i
        while j > 0 and scratch[8, j - 1] > x:
            scratch[8, j], scratch[9, j] = scratch[8, j - 1], scratch[9, j - 1]
            j -= 1
        scratch[8, j], scratch[9, j] = x, s


@njit(cache=True, nogil=True)
def _lines(p, begin, end, top, left, scratch):
    """Prepare pieces p[begin:end] for `_width`, relative to the pixel's corner; returns the number of events.

    Rows of scratch: 1, 2 lower and upper height of a piece that is not level, 3, 4 its x = row 3 + y * row 4, 5 whether it runs
    down (+1) or up (-1); 6, 7 events on the pixel's left side, heights and steps of the winding number.
    """
    events = 0
    for i in range(begin, end):
        xa, ya, xb, yb = p[i, 0] - left, p[i, 1] - top, p[i, 2] - left, p[i, 3] - top
        k = i - begin
        slope = (xb - xa) / (yb - ya) if yb != ya else 0.0
        scratch[1, k], scratch[2, k] = min(ya, yb), max(ya, yb)
        scratch[3, k], scratch[4, k] = xa - ya * slope, slope
        scratch[5, k] = 1.0 if yb > ya else -1.0
        if xa == 0.0:
            scratch[6, events], scratch[7, events] = ya, -1.0
            events += 1
        if xb == 0.0:
            scratch[6, events], scratch[7, events] = yb, 1.0
            events += 1
    return events


@njit(cache=True, nogil=True)
def _width(count, events, y, corner, scratch):
    """Covered width on the line y of the pixel. No branch depends on where a piece is: those would be guessed wrongly."""
    winding, n = corner, 0
    for i in range(events):
        winding += scratch[7, i] * (scratch[6, i] < y)
    for i in range(count):
        scratch[8, n] = min(max(scratch[3, i] + y * scratch[4, i], 0.0), 1.0)
        scratch[9, n] = scratch[5, i]
        n += (scratch[1, i] < y) & (y < scratch[2, i])
    if n > 1:
        _sort(scratch, n)
    covered, x = 0.0, 0.0
    for i in range(n):
        covered += (scratch[8, i] - x) * (winding > 0.0)
        winding += scratch[9, i]
        x = scratch[8, i]
    return covered + (1.0 - x) * (winding > 0.0)


@njit(cache=True, nogil=True, inline="always")
def _end(p, i, lower):
    """(x, y) of the end of piece i with the larger y, or else of the other one."""
    if (p[i, 3] > p[i, 1]) == lower:
        return p[i, 2], p[i, 3]
    return p[i, 0], p[i, 1]


@njit(cache=True, nogil=True, inline="always")
def _drop(i, j, scratch):
    """How much less the winding number beside piece i may be than at its middle, because it meets piece j; 0 at most.

    Piece j counts where it is on the left of i, and where they meet it changes sides. Where j runs past the middle of i both
    cases are known; else the chain of j goes on there, and a meeting changes the winding number by one.
    """
    y = 0.5 * (scratch[1, i] + scratch[2, i])
    if not (scratch[1, j] <= y and y < scratch[2, j]):
        return -1.0
    beside = scratch[3, j] + y * scratch[4, j] < scratch[3, i] + y * scratch[4, i]
    return min(scratch[5, j], 0.0) - scratch[5, j] * beside


@njit(cache=True, nogil=True)
def _meetings(p, begin, count, scratch):
    """Pairs of pieces that cross or run on top of each other, and in row 10 of scratch what `_drop` says of each piece.

    Two ends at the same place do not count; an end as near as that to another piece does, as the chain may go on across it.
    -1 when a piece is too flat to tell.
    """
    scratch[10, :count] = 0.0
    total = 0
    for i in range(count):
        if not abs(scratch[4, i]) < STEEPEST or scratch[1, i] == scratch[2, i]:
            return -1
        for j in range(i):
            low, high = max(scratch[1, i], scratch[1, j]), min(scratch[2, i], scratch[2, j])
            if low >= high:
                continue
            shift, slope = scratch[3, i] - scratch[3, j], scratch[4, i] - scratch[4, j]
            above, below = shift + slope * low, shift + slope * high
            meet = not ((above > NEAR or below > NEAR) and above > -NEAR and below > -NEAR)
            meet &= not ((above < -NEAR or below < -NEAR) and above < NEAR and below < NEAR)
            if not meet and abs(above) <= NEAR:
                meet = _end(p, begin + i, False) != _end(p, begin + j, False)
            if not meet and abs(below) <= NEAR:
                meet = _end(p, begin + i, True) != _end(p, begin + j, True)
            if meet:
                total += 1
                scratch[10, i] += _drop(i, j, scratch)
                scratch[10, j] += _drop(j, i, scratch)
    return total


@njit(cache=True, nogil=True)
def _windings(count, events, corner, scratch):
    """Row 11 of scratch: the winding number just left of the middle of each piece."""
    for i in range(count):
        y = 0.5 * (scratch[1, i] + scratch[2, i])
        x = scratch[3, i] + y * scratch[4, i]
        winding = corner
        for e in range(events):
            winding += scratch[7, e] * (scratch[6, e] <= y)
        for j in range(count):
            beside = (scratch[1, j] <= y) & (y < scratch[2, j]) & (scratch[3, j] + y * scratch[4, j] < x)
            winding += scratch[5, j] * (beside & (i != j))
        scratch[11, i] = winding


@njit(cache=True, nogil=True)
def _least_winding(count, scratch):
    """A lower bound of the winding number in the pixel.

    Every part of the pixel has a piece on its border. From the middle of the piece to there the winding number beside it
    changes only where the piece meets others.
    """
    least = np.inf
    for i in range(count):
        least = min(least, scratch[11, i] + min(scratch[5, i], 0.0) + scratch[10, i])
    return least


@njit(cache=True, nogil=True)
def _area_between(p, begin, end, top, left, corner, scratch):
    """Covered area of a pixel whose pieces do not meet: the integral of the winding number over the pieces that bound it.

    Along a piece that meets no other the winding number on either side is the same from end to end. Pieces with 0 on one side
    and 1 on the other are the border of what is covered.
    """
    area = 1.0 if corner > 0.0 else 0.0
    for i in range(end - begin):
        if min(scratch[11, i], scratch[11, i] + scratch[5, i]) == 0.0:
            area += _integral(p, begin + i, left, top)
    return area


@njit(cache=True, nogil=True)
def covered_area(p, begin, end, total, left, top, scratch):
    """Area of the pixel (left, top) in which the winding number is positive.

    p[begin:end] (k, 4) f8: its pieces. total: the integral of the winding number over the pixel. scratch: (12, n) f8, n at
    least 2 k and at least 2 + 2 m + m^2 with m = min(k, EXACT_PIECES).
    """
    count = end - begin
    corner = _corner_winding(p, begin, end, total, left, top)
    events = _lines(p, begin, end, top, left, scratch)
    meetings = _meetings(p, begin, count, scratch)
    if meetings >= 0:
        _windings(count, events, corner, scratch)
        if _least_winding(count, scratch) > 0.0:
            return 1.0
        if meetings == 0:
            return _area_between(p, begin, end, top, left, corner, scratch)
    area = 0.0
    if count > EXACT_PIECES:
        for i in range(SLABS):
            area += _width(count, events, (i + 0.5) / SLABS, corner, scratch)
        return area / SLABS
    heights = scratch[0]
    n = _heights(p, begin, end, top, heights)
    for i in range(n - 1):
        y = 0.5 * ((heights[i] - top) + (heights[i + 1] - top))
        area += _width(count, events, y, corner, scratch) * (heights[i + 1] - heights[i])
    return area


@njit(cache=True, nogil=True)
def gather(pieces, places, state, doubtful, number, offsets, own):
    """Sort the pieces of doubtful pixels by pixel into own (n, 4) f8: pixel d has own[offsets[d]:offsets[d + 1]].

    pieces (n, 4) f8, places (n,) i4, state: of `coverage.cut`. doubtful (d,) i4: places. offsets (d + 2,) i4. number: scratch (i4) of the
    size of state. Returns the largest number of pieces of a pixel.
    """
    flat = state.reshape(-1)
    offsets[:] = 0
    for d in range(doubtful.shape[0]):
        number[doubtful[d]] = d
    for i in range(pieces.shape[0]):
        if flat[places[i]] == DOUBTFUL:
            offsets[number[places[i]] + 2] += 1
    most = 1
    for d in range(doubtful.shape[0]):
        most = max(most, offsets[d + 2])
        offsets[d + 2] += offsets[d + 1]
    # offsets[d + 1] is where the next piece of pixel d goes, and ends as where those of d + 1 begin
    for i in range(pieces.shape[0]):
        if flat[places[i]] == DOUBTFUL:
            d = number[places[i]]
            place = offsets[d + 1]
            own[place, 0], own[place, 1], own[place, 2], own[place, 3] = pieces[i, 0], pieces[i, 1], pieces[i, 2], pieces[i, 3]
            offsets[d + 1] += 1
    return most


@njit(cache=True, nogil=True)
def resolve(pieces, offsets, most, doubtful, sums, columns, mask, x0, y0):
    """Replace the mask of every doubtful pixel by its covered area. sums: flat, `columns` numbers a row; the rest as `gather`."""
    few = min(most, EXACT_PIECES)
    scratch = np.empty((12, max(2 * most + 1, 2 + 2 * few + few * few)))
    for d in range(doubtful.shape[0]):
        row, column = doubtful[d] // columns, doubtful[d] % columns
        left, top = np.float64(x0 + column), np.float64(y0 + row)
        area = covered_area(pieces, offsets[d], offsets[d + 1], sums[doubtful[d]], left, top, scratch)
        mask[y0 + row, x0 + column] = np.uint8(min(max(area, 0.0), 1.0) * 255.0 + 0.5)
