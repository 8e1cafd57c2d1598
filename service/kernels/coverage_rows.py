"""Covered areas of a rectangle of pixels, from segments to the mask in one call: no time is lost between the kernels."""

from __future__ import annotations

import numpy as np
from numba import njit

from service.kernels.coverage import cut, most_pieces, sweep
from service.kernels.coverage_pixels import gather, resolve


@njit(cache=True, nogil=True)
def columns_of(width):
    """Columns of the sums of so many pixels a row: one more, and whole words."""
    return (width + 8) // 8 * 8


@njit(cache=True, nogil=True)
def cover(segments, chosen, x0, y0, x1, y1, base, out, most, scratch):
    """Write the covered areas of the rectangle from (x0, y0) to (x1, y1) into out (h, w) u1, from segments (s, 4) f8,
    those with the numbers chosen (k,) i4; the others have nothing in these rows.

    base, out: see `service.silhouette.coverage.coverage_mask`; what lies left of the rectangle counts, what is right of it does not. most:
    pieces held at a time; with more, doubtful pixels stay clamped. scratch: (sums f8, state u1, state as u8 words, number i4, doubtful i4)
    of `columns_of` numbers a row, flat, (pieces (n, 4) f8, sorted pieces (n, 4) f8, places (n,) i4) as large as they happen to be, and
    offsets i4, of two more numbers than the first ones. Returns (how many pixels were doubtful, end of the columns written); -1, 0 when
    a segment is not finite.
    """
    sums, state, state8, number, doubtful, pieces, own, places, offsets = scratch
    rows, columns = y1 - y0, columns_of(x1 - x0)
    size = rows * columns
    needed = most_pieces(segments, chosen, x0, y0, x1, y1)
    if not needed < np.inf:
        return -1, 0
    room = np.int64(min(needed, np.float64(most)))
    if room > places.shape[0]:
        pieces, own, places = np.empty((room, 4)), np.empty((room, 4)), np.empty(room, np.int32)
    flat = state[:size]
    flat[:] = 0
    grid, lines = sums[:size].reshape(rows, columns), flat.reshape(rows, columns)
    start, goes, count = 0, 0, 0
    while start < chosen.shape[0]:
        count, start = cut(segments, chosen, start, x0, y0, x1, y1, grid, lines, pieces[:room], places)
        goes += 1
    found, end = sweep(grid, lines, state8[: size // 8].reshape(rows, columns // 8), base, x0, y0, x1, y1, out, doubtful)
    if found and goes == 1:
        listed = doubtful[:found]
        longest = gather(pieces[:count], places, flat, listed, number, offsets[: found + 2], own)
        resolve(own, offsets, longest, listed, sums, columns, out, x0, y0)
    return found, end
