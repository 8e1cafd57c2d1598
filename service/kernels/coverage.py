"""Exact area of a polygon in every pixel, from its directed edges: signed areas, then sums along the rows.

Every edge is cut at the pixel borders into pieces. A piece that falls by dy inside a pixel adds dy to everything right of it
in its row; inside its own pixel it adds dy times the part of the pixel that lies right of its middle. The sum along a row
is then the integral of the winding number over each pixel (scan conversion by signed areas, as font renderers do it).

Clamping that integral to 0..1 is the covered area only where the winding number inside the pixel does not go from 0 to 2
or more. Here that is decided, not hoped for: each pixel counts how often pieces touch its border and in which directions
they run. With two touches at most and no turning back in x or in y, one chain without loops crosses the pixel, the
winding number has two neighbouring values, and the clamped integral is exact. All other pixels are handed on
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


@njit(cache=True, nogil=True)
def _add(sums, state, row, column, value):
    """Sums are written before they are added to, so that the buffer need not be cleared."""
    if state[row, column] & SUMMED:
        sums[row, column] += value
    else:
        state[row, column] |= SUMMED
        sums[row, column] = value


@njit(cache=True, nogil=True)
def _piece(sums, state, pieces, cells, n, row, column, left, top, xa, ya, xb, yb, falls):
    """One piece inside pixel (row, column) of the buffers, whose corner is (left, top); xa..yb runs down, falls is +-1."""
    if xa == xb and ya == yb:
        return n
    if falls < 0.0:
        xa, ya, xb, yb = xb, yb, xa, ya
    drop = yb - ya
    part = 1.0 - 0.5 * ((xa - left) + (xb - left))
    if drop != 0.0:
        _add(sums, state, row, column, drop * part)
        _add(sums, state, row, column + 1, drop - drop * part)
    now = state[row, column]
    if xb > xa:
        now |= RIGHT
    elif xb < xa:
        now |= LEFT
    if drop > 0.0:
        now |= DOWN
    elif drop < 0.0:
        now |= UP
    right, bottom = left + 1.0, top + 1.0
    touches = (now >> 5) + (xa == left or xa == right or ya == top or ya == bottom)
    touches += xb == left or xb == right or yb == top or yb == bottom
    state[row, column] = (now & 31) | (min(touches, 7) << 5)
    if n < cells.shape[0]:
        pieces[n, 0], pieces[n, 1], pieces[n, 2], pieces[n, 3] = xa, ya, xb, yb
        cells[n] = row * state.shape[1] + column
    return n + 1


@njit(cache=True, nogil=True)
def _row(sums, state, pieces, cells, n, row, x0, y0, top, xa, ya, xb, yb, falls, width):
    """A part of an edge inside one row of pixels, top of the row `top`; ya <= yb, both within the row."""
    if xa >= width and xb >= width:
        return n
    if xa <= 0.0 and xb <= 0.0:
        if yb > ya:
            _add(sums, state, row, 0, falls * (yb - ya))
        return n
    low, high = (xa, xb) if xa < xb else (xb, xa)
    first, last = np.int64(np.floor(max(low, 0.0))), np.int64(np.ceil(min(high, np.float64(width)))) - 1
    if last <= first and low >= 0.0 and high <= width:
        return _piece(sums, state, pieces, cells, n, row, first - x0, np.float64(first), top, xa, ya, xb, yb, falls)
    slope = (yb - ya) / (xb - xa)
    step = 1 if xb > xa else -1
    x, y = xa, ya
    if step > 0 and xa < 0.0:
        x, y = 0.0, min(max(ya - xa * slope, ya), yb)
        _add(sums, state, row, 0, falls * (y - ya))
    elif step < 0 and xa > width:
        x, y = np.float64(width), min(max(ya + (width - xa) * slope, ya), yb)
    column, end = (first, last) if step > 0 else (last, first)
    while True:
        border = np.float64(column + (step > 0))
        if column == end and ((step > 0 and xb <= border) or (step < 0 and xb >= border)):
            return _piece(sums, state, pieces, cells, n, row, column - x0, np.float64(column), top, x, y, xb, yb, falls)
        at = min(max(ya + (border - xa) * slope, y), yb)
        n = _piece(sums, state, pieces, cells, n, row, column - x0, np.float64(column), top, x, y, border, at, falls)
        x, y = border, at
        if column == end:
            break
        column += step
    if step < 0:
        _add(sums, state, row, 0, falls * (yb - y))
    return n


@njit(cache=True, nogil=True)
def accumulate(segments, width, x0, y0, y1, sums, state, pieces, cells):
    """Cut segments (s, 4) f8 into pieces and add them up; returns the number of pieces (more than fit when > len(cells)).

    The buffers hold rows y0..y1 and columns from x0 on; segments left of column x0 must be left of the image.
    """
    n = 0
    for s in range(segments.shape[0]):
        xa, ya, xb, yb = segments[s, 0], segments[s, 1], segments[s, 2], segments[s, 3]
        falls = 1.0
        if ya > yb:
            xa, ya, xb, yb, falls = xb, yb, xa, ya, -1.0
        if yb < y0 or ya >= y1 or (xa >= width and xb >= width):
            continue
        if ya == yb:
            row = np.int64(np.floor(ya))
            n = _row(sums, state, pieces, cells, n, row - y0, x0, y0, np.float64(row), xa, ya, xb, yb, falls, width)
            continue
        low, high = min(xa, xb), max(xa, xb)
        slope = (xb - xa) / (yb - ya)
        first, last = np.int64(np.floor(max(ya, np.float64(y0)))), np.int64(np.ceil(min(yb, np.float64(y1)))) - 1
        x = xa if ya >= first else min(max(xa + (first - ya) * slope, low), high)
        y = max(ya, np.float64(first))
        for row in range(first, last + 1):
            bottom = np.float64(row + 1)
            if bottom >= yb:
                xe, ye = xb, yb
            else:
                xe, ye = min(max(xa + (bottom - ya) * slope, low), high), bottom
            n = _row(sums, state, pieces, cells, n, row - y0, x0, y0, np.float64(row), x, y, xe, ye, falls, width)
            x, y = xe, ye
    return n


@njit(cache=True, nogil=True)
def _simple(now):
    """Whether one chain at most crosses the pixel, without turning back."""
    return (now >> 5) <= 2 and ((now & (RIGHT | LEFT)) != RIGHT | LEFT or (now & (DOWN | UP)) != DOWN | UP)


@njit(cache=True, nogil=True)
def sweep(sums, state, state8, base, mask, x0, y0, x1, y1, doubtful):
    """Sum along the rows into mask (h, w) u1; returns how many pixels are doubtful.

    Those get the state DOUBTFUL, their sum in `sums` and their place (row * columns + column) in doubtful. state8 is state
    as u8 words: where a word is zero, eight pixels have the value of the one before.
    """
    count = 0
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
    return count


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


@njit(cache=True, nogil=True)
def count_pieces(segments, width, height):
    """Upper bound of the number of pieces the segments are cut into."""
    total = 0.0
    for s in range(segments.shape[0]):
        xa, ya, xb, yb = segments[s, 0], segments[s, 1], segments[s, 2], segments[s, 3]
        across = min(max(xa, xb, 0.0), width) - max(min(xa, xb, width), 0.0)
        down = min(max(ya, yb, 0.0), height) - max(min(ya, yb, height), 0.0)
        total += np.ceil(max(across, 0.0)) + np.ceil(max(down, 0.0)) + 3.0
    return total
