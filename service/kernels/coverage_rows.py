"""Covered areas of a rectangle of pixels, from segments to the mask in one call: no time is lost between the kernels."""

from __future__ import annotations

import numpy as np
from numba import njit

from service.kernels.coverage import cut, sweep
from service.kernels.coverage_pixels import gather, resolve

WORTH_A_LOOK = 3  # doubtful pixels for each segment of the inside from which on drawing that is the cheaper way
FULL = 255


@njit(cache=True, nogil=True)
def scratch_sizes(pixels, room):
    """(floats, ints, bytes) that `cover` needs for so many pixels, each row filled up, and pieces."""
    return 2 * pixels + 8 * room, 2 * pixels + 2 * room + 2, 3 * pixels


@njit(cache=True, nogil=True)
def _drop_covered(inside, width, x0, y0, x1, y1, sums, state, state8, covered, pieces, places, listed, looks, doubtful, found, out):
    """Fill doubtful pixels that segments `inside` (s, 4) f8 cover, and take them off the list; returns how many are left.

    state and covered (rows, columns) u1 are empty. What is doubtful with the inside too counts as not covered by it. looks (flat) u1: the
    state of the pixels without the inside; that of those taken off becomes 0.
    """
    start = 0
    while start < inside.shape[0]:
        _, start = cut(inside, start, width, x0, y0, y1, sums, state, pieces, places)
    unclear, _ = sweep(sums, state, state8, 0.0, 0, 0, x1 - x0, y1 - y0, covered, listed)
    flat, columns, left = covered.reshape(-1), covered.shape[1], 0
    for i in range(unclear):
        flat[listed[i]] = 0
    for i in range(found):
        place = doubtful[i]
        if flat[place] == FULL:
            out[y0 + place // columns, x0 + place % columns] = FULL
            looks[place] = 0
        else:
            doubtful[left] = place
            left += 1
    return left


@njit(cache=True, nogil=True)
def cover(segments, width, x0, y0, x1, y1, base, inside, out, room, floats, ints, state, state8):
    """Write the rows y0..y1 of out (h, w) u1, which are empty, from segments (s, 4) f8 that touch no other columns than x0..x1.

    inside (i, 4) f8: segments of something that lies inside. base, and all else: see `service.silhouette.coverage.coverage_mask`. room:
    pieces held at a time. floats (f8), ints (i4), state (u1, and state8 the same as u8 words): scratch, as large as `scratch_sizes`
    says of the rectangle with its rows filled up to (x1 - x0 + 8) // 8 * 8. Returns (how many pixels were doubtful, end of the columns
    written).
    """
    rows, columns = y1 - y0, (x1 - x0 + 8) // 8 * 8
    size = rows * columns
    sums, others = floats[:size].reshape(rows, columns), floats[size : 2 * size].reshape(rows, columns)
    pieces = floats[2 * size : 2 * size + 4 * room].reshape(room, 4)
    own = floats[2 * size + 4 * room : 2 * size + 8 * room].reshape(room, 4)
    places, doubtful, number = ints[:room], ints[room : room + size], ints[room + size : room + 2 * size]
    rest = ints[room + 2 * size :]
    state[:size] = 0
    lines, words = state[:size].reshape(rows, columns), state8[: size // 8].reshape(rows, columns // 8)
    start, goes, count = 0, 0, 0
    while start < segments.shape[0]:
        count, start = cut(segments, start, width, x0, y0, y1, sums, lines, pieces, places)
        goes += 1
    found, end = sweep(sums, lines, words, base, x0, y0, x1, y1, out, doubtful)
    left = found
    if found > WORTH_A_LOOK * inside.shape[0] > 0:
        state[size : 3 * size] = 0
        lines, words = state[size : 2 * size].reshape(rows, columns), state8[size // 8 : size // 4].reshape(rows, columns // 8)
        covered = state[2 * size : 3 * size].reshape(rows, columns)
        left = _drop_covered(inside, width, x0, y0, x1, y1, others, lines, words, covered, own, rest, number, state, doubtful, found, out)
    if left and goes == 1:
        offsets = rest[: left + 2]
        most = gather(pieces[:count], places, state, doubtful[:left], number, offsets, own)
        resolve(own, offsets, most, doubtful[:left], floats, columns, out, x0, y0)
    return found, end
