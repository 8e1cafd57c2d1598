"""Covered areas of a rectangle of pixels, from segments to the mask in one call: no time is lost between the kernels."""

from __future__ import annotations

from numba import njit

from service.kernels.coverage import cut, sweep
from service.kernels.coverage_pixels import gather, resolve


@njit(cache=True, nogil=True)
def scratch_sizes(pixels, room):
    """(floats, ints) that `cover` needs for so many pixels, each row filled up, and pieces."""
    return pixels + 8 * room, 2 * pixels + 2 * room + 2


@njit(cache=True, nogil=True)
def cover(segments, width, x0, y0, x1, y1, base, out, room, floats, ints, state, state8):
    """Write the rows y0..y1 of out (h, w) u1, which are empty, from segments (s, 4) f8 that touch no other columns than x0..x1.

    base: see `service.silhouette.coverage.coverage_mask`. room: pieces held at a time. floats (f8), ints (i4): scratch, as large as
    `scratch_sizes` says of the rectangle with its rows filled up to (x1 - x0 + 8) // 8 * 8; state (u1, and state8 the same as u8 words):
    scratch, of its size. Returns (how many pixels were doubtful, end of the columns written).
    """
    rows, columns = y1 - y0, (x1 - x0 + 8) // 8 * 8
    size = rows * columns
    sums, pieces = floats[:size].reshape(rows, columns), floats[size : size + 4 * room].reshape(room, 4)
    own = floats[size + 4 * room : size + 8 * room].reshape(room, 4)
    places, doubtful, number = ints[:room], ints[room : room + size], ints[room + size : room + 2 * size]
    lines = state.reshape(rows, columns)
    state[:] = 0
    start, goes, count = 0, 0, 0
    while start < segments.shape[0]:
        count, start = cut(segments, start, width, x0, y0, y1, sums, lines, pieces, places)
        goes += 1
    found, end = sweep(sums, lines, state8.reshape(rows, columns // 8), base, x0, y0, x1, y1, out, doubtful)
    if found and goes == 1:
        offsets = ints[room + 2 * size : room + 2 * size + found + 2]
        most = gather(pieces[:count], places, state, doubtful[:found], number, offsets, own)
        resolve(own, offsets, most, doubtful[:found], floats, columns, out, x0, y0)
    return found, end
