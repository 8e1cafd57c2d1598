"""Exact area of a polygon in every pixel, from its directed edges: signed areas, then sums along the rows.

Every edge is cut at the pixels' sides into pieces. A piece that falls by dy inside a pixel adds dy to everything right of it
in its row; inside its own pixel it adds dy times the part of the pixel that lies right of its middle. The sum along a row
is then the integral of the winding number over each pixel (scan conversion by signed areas, as font renderers do it).

Clamping that integral to 0..1 gives the covered area only where the winding number inside the pixel does not go from 0 to 2
or more. Here that is decided, not hoped for: each pixel counts how often pieces touch its sides and notes in which directions
they run. With two touches at most and no turning back in x or in y, one chain without loops crosses the pixel, the
winding number has two neighbouring values, and the clamped integral is exact. All other pixels are doubtful and handed on
(`coverage_pixels`), with the pieces that cross them.
"""

from __future__ import annotations

import numpy as np
from numba import njit

# one byte a pixel: what its pieces are like
SUMMED = 1  # its sum has been written
RIGHT, LEFT, DOWN, UP = 2, 4, 8, 16  # some piece runs that way
TOUCH = 32  # three bits: pieces' ends on the border, 0..7
DOUBTFUL = 255
OUTSIDE = -1.0  # x of a piece that is left of the image


@njit(cache=True, nogil=True, inline="always")
def _put(pieces, pixels, n, row, column, xa, ya, xb, yb, falls):
    """Append a piece, with its own direction again: xa..yb runs down, falls is -1 when the edge runs up."""
    if falls > 0.0:
        pieces[n, 0], pieces[n, 1], pieces[n, 2], pieces[n, 3] = xa, ya, xb, yb
    else:
        pieces[n, 0], pieces[n, 1], pieces[n, 2], pieces[n, 3] = xb, yb, xa, ya
    pixels[n, 0], pixels[n, 1] = row, column
    return n + 1


@njit(cache=True, nogil=True)
def _cut_row(pieces, pixels, n, row, xa, ya, xb, yb, falls, width):
    """Cut a part of an edge inside one row at the pixels' sides; ya <= yb. What is left of the image becomes x = OUTSIDE."""
    if xa >= width and xb >= width:
        return n
    if xa <= 0.0 and xb <= 0.0:
        return _put(pieces, pixels, n, row, 0, OUTSIDE, ya, OUTSIDE, yb, falls)
    low, high = (xa, xb) if xa < xb else (xb, xa)
    first, last = np.int64(np.floor(max(low, 0.0))), np.int64(np.ceil(min(high, np.float64(width)))) - 1
    if last <= first and low >= 0.0 and high <= width:
        return _put(pieces, pixels, n, row, first, xa, ya, xb, yb, falls)
    slope = (yb - ya) / (xb - xa)
    step = 1 if xb > xa else -1
    x, y = xa, ya
    if step > 0 and xa < 0.0:
        x, y = 0.0, min(max(ya - xa * slope, ya), yb)
        n = _put(pieces, pixels, n, row, 0, OUTSIDE, ya, OUTSIDE, y, falls)
    elif step < 0 and xa > width:
        x, y = np.float64(width), min(max(ya + (width - xa) * slope, ya), yb)
    column, end = (first, last) if step > 0 else (last, first)
    while True:
        border = np.float64(column + (step > 0))
        if column == end and ((step > 0 and xb <= border) or (step < 0 and xb >= border)):
            return _put(pieces, pixels, n, row, column, x, y, xb, yb, falls)
        at = min(max(ya + (border - xa) * slope, y), yb)
        n = _put(pieces, pixels, n, row, column, x, y, border, at, falls)
        x, y = border, at
        if column == end:
            break
        column += step
    if step < 0:
        n = _put(pieces, pixels, n, row, 0, OUTSIDE, y, OUTSIDE, yb, falls)
    return n


@njit(cache=True, nogil=True)
def cut(segments, start, width, y0, y1, pieces, pixels):
    """Cut segments (s, 4) f8, from number `start` on, into pieces (n, 4) f8 of single pixels (n, 2) i4 (row, column).

    Rows outside y0..y1 drop out. Returns (n, next start): it stops when the next segment might not fit any more.
    """
    n = 0
    for s in range(start, segments.shape[0]):
        xa, ya, xb, yb = segments[s, 0], segments[s, 1], segments[s, 2], segments[s, 3]
        falls = 1.0
        if ya > yb:
            xa, ya, xb, yb, falls = xb, yb, xa, ya, -1.0
        if yb < y0 or ya >= y1 or (xa >= width and xb >= width):
            continue
        if n + _most_pieces(xa, ya, xb, yb, width, y0, y1) > pieces.shape[0]:
            return n, s
        if ya == yb:
            n = _cut_row(pieces, pixels, n, np.int64(np.floor(ya)), xa, ya, xb, yb, falls, width)
            continue
        first, last = np.int64(np.floor(max(ya, np.float64(y0)))), np.int64(np.ceil(min(yb, np.float64(y1)))) - 1
        if first == last and ya >= first and yb <= first + 1:
            n = _cut_row(pieces, pixels, n, first, xa, ya, xb, yb, falls, width)
            continue
        low, high = min(xa, xb), max(xa, xb)
        slope = (xb - xa) / (yb - ya)
        x, y = xa, ya
        if ya < first:
            x, y = min(max(xa + (first - ya) * slope, low), high), np.float64(first)
        for row in range(first, last + 1):
            xe, ye = xb, yb
            if yb > row + 1:
                xe, ye = min(max(xa + (row + 1 - ya) * slope, low), high), np.float64(row + 1)
            n = _cut_row(pieces, pixels, n, row, x, y, xe, ye, falls, width)
            x, y = xe, ye
    return n, segments.shape[0]


@njit(cache=True, nogil=True, inline="always")
def _most_pieces(xa, ya, xb, yb, width, y0, y1):
    """Upper bound of the number of pieces of a segment: the sides it crosses, and some."""
    across = min(max(xa, xb, 0.0), width) - max(min(xa, xb, width), 0.0)
    down = min(yb, np.float64(y1)) - max(ya, np.float64(y0))
    return 2.0 * np.ceil(max(down, 0.0)) + np.ceil(max(across, 0.0)) + 5.0


@njit(cache=True, nogil=True)
def most_pieces(segments, width, height):
    """Upper bound of the number of pieces of all segments."""
    total = 0.0
    for s in range(segments.shape[0]):
        low, high = min(segments[s, 1], segments[s, 3]), max(segments[s, 1], segments[s, 3])
        total += _most_pieces(segments[s, 0], low, segments[s, 2], high, width, 0, height)
    return total


@njit(cache=True, nogil=True)
def accumulate(pieces, pixels, count, x0, y0, sums, state):
    """Add up the first `count` pieces. sums (rows, columns) f8 need not be cleared, state (rows, columns) u1 must be."""
    for i in range(count):
        xa, ya, xb, yb = pieces[i, 0], pieces[i, 1], pieces[i, 2], pieces[i, 3]
        left, top = np.float64(pixels[i, 1]), np.float64(pixels[i, 0])
        row, column = np.uint64(pixels[i, 0] - y0), np.uint64(pixels[i, 1] - x0)
        drop = yb - ya
        now = state[row, column]
        if drop != 0.0:
            inside = 0.0 if xa < left else drop * (0.5 * ((xa - left) + (xb - left)))
            sums[row, column] = (sums[row, column] if now & SUMMED else 0.0) + (drop - inside)
            now |= SUMMED
            if inside != 0.0:
                after = column + np.uint64(1)
                sums[row, after] = (sums[row, after] if state[row, after] & SUMMED else 0.0) + inside
                state[row, after] |= SUMMED
        if xa >= left and (xa != xb or drop != 0.0):
            touches = (now >> 5) + _on_side(xa, ya, left, top) + _on_side(xb, yb, left, top)
            now |= RIGHT * (xb > xa) | LEFT * (xb < xa) | DOWN * (drop > 0.0) | UP * (drop < 0.0)
            now = (now & 31) | (min(touches, 7) << 5)
        state[row, column] = now


@njit(cache=True, nogil=True, inline="always")
def _on_side(x, y, left, top):
    return x in (left, left + 1.0) or y in (top, top + 1.0)


@njit(cache=True, nogil=True)
def _simple(now):
    """Whether one chain at most crosses the pixel, without turning back."""
    return (now >> 5) <= 2 and ((now & (RIGHT | LEFT)) != RIGHT | LEFT or (now & (DOWN | UP)) != DOWN | UP)


@njit(cache=True, nogil=True)
def sweep(sums, state, state8, base, mask, x0, y0, x1, y1, doubtful):
    """Sum along the rows into mask (h, w) u1; returns (how many pixels are doubtful, end of the columns written).

    Rows that are still covered at x1 are so to the end. Doubtful pixels get the state DOUBTFUL, their sum in `sums` and their
    place (row * columns + column) in doubtful. state8 is state as u8 words: where a word is zero, eight pixels have the value
    of the one before.
    """
    count, end_column = 0, x1
    columns = x1 - x0
    for row in range(y1 - y0):
        total = base
        line = mask[y0 + row]
        for word in range(state8.shape[1]):
            begin = 8 * word
            end = min(begin + 8, columns)
            if state8[row, word] == 0:
                value = np.uint8(min(max(total, 0.0), 1.0) * 255.0 + 0.5)
                if value:
                    for column in range(begin, end):
                        line[x0 + column] = value
                continue
            for column in range(begin, end):
                now = state[row, column]
                if now & SUMMED:
                    total += sums[row, column]
                line[x0 + column] = np.uint8(min(max(total, 0.0), 1.0) * 255.0 + 0.5)
                if not _simple(now):
                    state[row, column] = DOUBTFUL
                    sums[row, column] = total
                    doubtful[count] = row * state.shape[1] + column
                    count += 1
        if state[row, columns] & SUMMED:
            total += sums[row, columns]
        value = np.uint8(min(max(total, 0.0), 1.0) * 255.0 + 0.5)
        if value and x1 < mask.shape[1]:
            line[x1:] = value
            end_column = mask.shape[1]
    return count, end_column


@njit(cache=True, nogil=True)
def extent(segments):
    """(min x, min y, max x, max y); NaN anywhere gives NaN everywhere. 1, 1, 0, 0 without segments."""
    if segments.shape[0] == 0:
        return 1.0, 1.0, 0.0, 0.0
    low_x, high_x = segments[0, 0], segments[0, 0]
    low_y, high_y = segments[0, 1], segments[0, 1]
    check = 0.0
    for s in range(segments.shape[0]):
        xa, ya, xb, yb = segments[s, 0], segments[s, 1], segments[s, 2], segments[s, 3]
        low_x, high_x = min(low_x, xa, xb), max(high_x, xa, xb)
        low_y, high_y = min(low_y, ya, yb), max(high_y, ya, yb)
        check += 0.0 * (xa + ya + xb + yb)
    return low_x + check, low_y + check, high_x + check, high_y + check
