"""The covered part of single pixels that several chains cross: area where the winding number is positive.

Most need only a look (`coverage_lanes`): where all winding numbers beside pieces are positive the pixel is full; and when no pieces meet,
each has one winding number on its left and one on its right, and those between 0 and 1 are the border of the covered area.
In the others, between neighbouring heights of interest (ends and crossings of pieces), a pixel is a stack of slabs in which
the pieces are straight and do not meet, so the covered width is linear in y: its value at the middle of the slab, times the
height, is the area exactly. Those with more than EXACT_PIECES pieces are cut into SLABS slabs of equal height instead.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from geometry.borrowing import borrowing
from service.kernels.coverage import LISTED
from service.kernels.coverage_lanes import (
    AREA,
    COUNT,
    CROSSING_ROWS,
    LANES,
    LEFT,
    MIDDLE,
    OPEN,
    PIECE_ROWS,
    PIECES,
    SLAB_ROWS,
    THICK,
    TOP,
    TOTAL,
    settle,
    stacked_area,
)

EXACT_PIECES = 8
SLABS = 24


@borrowing
def _insert(heights, n, y):
    """Put y into the n sorted heights unless it is there; returns how many there are now."""
    j = n
    while j > 0 and heights[j - 1] > y:
        j -= 1
    if j > 0 and heights[j - 1] == y:
        return n
    for i in range(n, j, -1):
        heights[i] = heights[i - 1]
    heights[j] = y
    return n + 1


@borrowing
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


@borrowing
def _slabs(p, begin, end, top, heights, slabs):
    """Cut a pixel with pieces p[begin:end] into slabs, as `coverage_lanes.stacked_area` takes them; returns how many times LANES."""
    if end - begin > EXACT_PIECES:
        n = SLABS + 1
        for i in range(n):
            heights[i] = top + i / SLABS
    else:
        n = _heights(p, begin, end, top, heights)
    batches = (n - 1 + LANES - 1) // LANES
    for i in range(batches * LANES):
        at = i // LANES * SLAB_ROWS * LANES + i % LANES
        low, high = heights[min(i, n - 1)], heights[min(i + 1, n - 1)]
        slabs[at + MIDDLE * LANES], slabs[at + THICK * LANES] = 0.5 * ((low - top) + (high - top)), high - low
    return batches


@borrowing
def gather(pieces, places, state, doubtful, number, offsets, own):
    """Sort the pieces of doubtful pixels by pixel into own (n, 4) f8: pixel d has own[offsets[d]:offsets[d + 1]].

    pieces (n, 4) f8, places (n,) i4, state (flat): of `coverage.cut`. doubtful (d,) i4: places, the pixels to look
    into. offsets (d + 2,) i4. number: scratch (i4) of the size of state. Returns the largest number of pieces of a pixel.
    """
    offsets[:] = 0
    for d in range(doubtful.shape[0]):
        number[doubtful[d]] = d
        state[doubtful[d]] = LISTED
    for i in range(pieces.shape[0]):
        if state[places[i]] == LISTED:
            offsets[number[places[i]] + 2] += 1
    most = 1
    for d in range(doubtful.shape[0]):
        most = max(most, offsets[d + 2])
        offsets[d + 2] += offsets[d + 1]
    # offsets[d + 1] is where the next piece of pixel d goes, and ends as where those of d + 1 begin
    for i in range(pieces.shape[0]):
        if state[places[i]] == LISTED:
            d = number[places[i]]
            place = offsets[d + 1]
            own[place, 0], own[place, 1], own[place, 2], own[place, 3] = pieces[i, 0], pieces[i, 1], pieces[i, 2], pieces[i, 3]
            offsets[d + 1] += 1
    return most


@borrowing
def _by_count(offsets, first, order):
    """Number pixels by how many pieces they have, the most first, into order (d,) i4. first (most + 2,) i4: zeros."""
    most = first.shape[0] - 2
    for d in range(order.shape[0]):
        first[most - (offsets[d + 1] - offsets[d]) + 1] += 1
    for k in range(most + 1):
        first[k + 1] += first[k]
    for d in range(order.shape[0]):
        place = most - (offsets[d + 1] - offsets[d])
        order[first[place]] = d
        first[place] += 1


@borrowing
def _fill(block, lane, pieces, begin, end, total, left, top):
    """Put a pixel with its pieces into a lane of a block of `coverage_lanes.settle`."""
    at = np.uint64(lane)
    block[TOTAL * LANES + at], block[LEFT * LANES + at], block[TOP * LANES + at], block[COUNT * LANES + at] = total, left, top, end - begin
    at += np.uint64(PIECES * LANES)
    for q in range(np.uint64(begin), np.uint64(end)):
        for k in range(np.uint64(4)):
            block[at + k * np.uint64(LANES)] = pieces[q, k]
        at += np.uint64(PIECE_ROWS * LANES)


@njit(cache=True, nogil=True)
def resolve(pieces, offsets, most, doubtful, sums, columns, mask, x0, y0):
    """Replace the mask of every doubtful pixel by its covered area. sums: flat, `columns` numbers a row; the rest as `gather`."""
    few, pixels = min(most, EXACT_PIECES), doubtful.shape[0]
    heights = np.empty(max(SLABS + 1, 2 + 2 * few + few * few) + LANES)
    slabs, crossings = np.empty(heights.size * SLAB_ROWS), np.empty(CROSSING_ROWS * most * LANES)
    block, order = np.empty((PIECES + PIECE_ROWS * most) * LANES), np.empty(pixels, np.int32)
    _by_count(offsets, np.zeros(most + 2, np.int32), order)
    for first in range(0, pixels, LANES):
        lanes = min(LANES, pixels - first)
        longest = offsets[order[first] + 1] - offsets[order[first]]
        for lane in range(lanes):
            d = order[first + lane]
            row, column = doubtful[d] // columns, doubtful[d] % columns
            _fill(block, lane, pieces, offsets[d], offsets[d + 1], sums[doubtful[d]], np.float64(x0 + column), np.float64(y0 + row))
        for lane in range(lanes, LANES):
            block[COUNT * LANES + lane] = 0.0
        settle(block, longest)
        for lane in range(lanes):
            area, left, top = block[AREA * LANES + lane], block[LEFT * LANES + lane], block[TOP * LANES + lane]
            if block[OPEN * LANES + lane] != 0.0:
                begin, end = offsets[order[first + lane]], offsets[order[first + lane] + 1]
                batches = _slabs(pieces, begin, end, top, heights, slabs)
                area = stacked_area(block, lane, end - begin, slabs, batches, crossings)
            mask[np.int64(top), np.int64(left)] = np.uint8(min(max(area, 0.0), 1.0) * 255.0 + 0.5)
