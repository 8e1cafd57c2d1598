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

from geometry.borrowing import borrowing

# one byte a pixel: what its pieces are like
SUMMED = 1  # its sum has been written
RIGHT, LEFT, DOWN, UP = 2, 4, 8, 16  # some piece runs that way
TOUCH = 32  # three bits: pieces' ends on the border, 0..7
LISTED = 255  # the pixel is looked into
NEARLY = 1e-9  # bands


@borrowing
def cut(segments, chosen, start, x0, y0, x1, y1, sums, state, pieces, places):
    """Cut segments (s, 4) f8, those with the numbers chosen[start:] (i4), at the sides of pixels into pieces, and add these up.

    sums (rows, columns) f8, state (rows, columns) u1: of the pixels from (x0, y0) on; sums need not be cleared, state must be.
    Of the image, rows outside y0..y1 and what is right of x1 drop out; what is left of x0 covers whole rows. pieces (n, 4) f8, places
    (n,) i4: row * columns + column. Returns (how many pieces, next start): it stops when the next segment might not fit any more.
    """
    n, columns, left_side, right_side = 0, np.uint64(state.shape[1]), np.float64(x0), np.float64(x1)
    for t in range(start, chosen.shape[0]):
        s = np.uint64(chosen[t])
        px, py, qx, qy = segments[s, 0], segments[s, 1], segments[s, 2], segments[s, 3]
        down = py <= qy
        if not down:
            px, py, qx, qy = qx, qy, px, py
        falls = 1.0 if down else -1.0
        if qy < y0 or py >= y1 or (px >= x1 and qx >= x1):
            continue
        if n + _most_pieces(px, py, qx, qy, x0, y0, x1, y1) > pieces.shape[0]:
            return n, t
        first, last = np.int64(np.floor(max(py, np.float64(y0)))), np.int64(np.ceil(min(qy, np.float64(y1)))) - 1
        last = max(first, last)
        low, high = min(px, qx), max(px, qx)
        run = (qx - px) / (qy - py) if qy > py else 0.0
        rise = (qy - py) / (qx - px) if qx != px else 0.0
        x, y = px, py
        if py < first:
            x, y = min(max(px + (first - py) * run, low), high), np.float64(first)
        for row in range(first, last + 1):
            # the part of the segment in this row: (xa, ya) to (xb, yb), held inside the image from (x, y) to (xe, ye)
            xa, ya, xb, yb = x, y, qx, qy
            if qy > row + 1:
                xb, yb = min(max(px + (row + 1 - py) * run, low), high), np.float64(row + 1)
            x, y = xb, yb
            r = np.uint64(row - y0)
            if xa >= right_side and xb >= right_side:
                continue
            xs, ys, xe, ye = xa, ya, xb, yb
            if xa < left_side or xb < left_side or xa > right_side or xb > right_side:
                left = 0.0
                at = min(max(ya + (left_side - xa) * rise, ya), yb)
                if xa < left_side:
                    xs, ys = left_side, yb if xb < left_side else at
                    left += ys - ya
                elif xb < left_side:
                    xe, ye = left_side, at
                    left += yb - ye
                if left != 0.0:
                    before, now = sums[r, 0], state[r, 0]
                    sums[r, 0] = (before if now & SUMMED else 0.0) + falls * left
                    state[r, 0] = now | SUMMED
                if xa < left_side and xb < left_side:
                    continue
                at = min(max(ya + (right_side - xa) * rise, ya), yb)
                if xa > right_side:
                    xs, ys = right_side, at
                elif xb > right_side:
                    xe, ye = right_side, at
            forwards = xe >= xs
            column = np.int64(np.floor(xs)) if forwards else np.int64(np.ceil(xs)) - 1
            end = max(np.int64(np.ceil(xe)) - 1, column) if forwards else np.int64(np.floor(xe))
            step = 1 if forwards else -1
            while True:
                bx, by = xe, ye
                if column != end:
                    bx = np.float64(column + forwards)
                    by = min(max(ya + (bx - xa) * rise, ys), yb)
                c = np.uint64(column - x0)
                drop = falls * (by - ys)
                before, now = sums[r, c], state[r, c]
                if xs != bx or ys != by:
                    side, top = np.float64(column), np.float64(row)
                    inside = drop * (0.5 * ((xs - side) + (bx - side)))
                    sums[r, c] = (before if now & SUMMED else 0.0) + (drop - inside)
                    touches = (now >> 5) + _on_side(xs, ys, side, top) + _on_side(bx, by, side, top)
                    across = falls * (bx - xs)
                    runs = RIGHT * (across > 0.0) + LEFT * (across < 0.0) + DOWN * (drop > 0.0) + UP * (drop < 0.0)
                    state[r, c] = (now & 30) | runs | (min(touches, 7) << 5) | SUMMED
                    after = c + np.uint64(1)
                    before, now = sums[r, after], state[r, after]
                    sums[r, after] = (before if now & SUMMED else 0.0) + inside
                    state[r, after] = now | SUMMED
                    pieces[n, 0], pieces[n, 1] = xs if down else bx, ys if down else by
                    pieces[n, 2], pieces[n, 3] = bx if down else xs, by if down else ys
                    places[n] = np.int32(r * columns + c)
                    n += 1
                if column == end:
                    break
                xs, ys = bx, by
                column += step
    return n, chosen.shape[0]


@borrowing
def _on_side(x, y, left, top):
    """1 on the pixel's border, else 0; without branches, which would be guessed wrongly."""
    return (x == left) | (x == left + 1.0) | (y == top) | (y == top + 1.0)


@borrowing
def _most_pieces(xa, ya, xb, yb, x0, y0, x1, y1):
    """Upper bound of the number of pieces of a segment: the sides it crosses, and some."""
    across = min(max(xa, xb, np.float64(x0)), np.float64(x1)) - max(min(xa, xb, np.float64(x1)), np.float64(x0))
    down = min(yb, np.float64(y1)) - max(ya, np.float64(y0))
    return 2.0 * np.ceil(max(down, 0.0)) + np.ceil(max(across, 0.0)) + 5.0


@borrowing
def most_pieces(segments, chosen, x0, y0, x1, y1):
    """Upper bound of the number of pieces that `cut` makes; NaN where a coordinate is."""
    pieces, check = 0.0, 0.0
    for t in range(chosen.shape[0]):
        s = np.uint64(chosen[t])
        xa, ya, xb, yb = segments[s, 0], segments[s, 1], segments[s, 2], segments[s, 3]
        check += 0.0 * (xa + ya + xb + yb)
        if max(ya, yb) >= y0 and min(ya, yb) < y1:
            pieces += _most_pieces(xa, min(ya, yb), xb, max(ya, yb), x0, y0, x1, y1)
    return pieces + check


@borrowing
def _spans(segments, y0, height, rows, spans):
    """First and last band of each segment into spans (s, 2) i2, rather one too many than one too few; whether all are finite."""
    scale, check = 1.0 / rows, 0.0
    for s in range(np.uint64(segments.shape[0])):
        ya, yb = segments[s, 1], segments[s, 3]
        check += 0.0 * (segments[s, 0] + ya + segments[s, 2] + yb)
        low, high = min(max(min(ya, yb) - y0, 0.0), height), min(max(max(ya, yb) - y0, 0.0), height - 1.0)
        spans[s, 0], spans[s, 1] = np.int16(low * scale - NEARLY), np.int16(high * scale + NEARLY)
    return check == 0.0


@borrowing
def _count(spans, starts):
    """Add the number of segments of band b to starts[b + 2]."""
    for s in range(np.uint64(spans.shape[0])):
        for band in range(np.uint64(spans[s, 0]), np.uint64(spans[s, 1]) + np.uint64(1)):
            starts[band + np.uint64(2)] += 1


@borrowing
def _list(spans, starts, chosen):
    """Put the segments of band b from chosen[starts[b + 1]] on; starts[b + 1] is then where they end."""
    for s in range(np.uint64(spans.shape[0])):
        for band in range(np.uint64(spans[s, 0]) + np.uint64(1), np.uint64(spans[s, 1]) + np.uint64(2)):
            chosen[starts[band]] = np.int32(s)
            starts[band] += 1


@njit(cache=True, nogil=True)
def by_band(segments, y0, y1, rows):
    """Numbers of the segments (s, 4) f8 that each band of `rows` rows of y0..y1 may have something of: (whether all are finite, starts
    (b + 1,) i4, chosen (n,) i4), those of band b being chosen[starts[b]:starts[b + 1]].
    """
    bands = (y1 - y0 + rows - 1) // rows
    spans, starts = np.empty((segments.shape[0], 2), np.int16), np.zeros(bands + 2, np.int32)
    finite = _spans(segments, np.float64(y0), np.float64(y1 - y0), np.float64(rows), spans)
    if finite:
        _count(spans, starts)
    for band in range(bands):
        starts[band + 2] += starts[band + 1]
    chosen = np.empty(starts[bands + 1], np.int32)
    if finite:
        _list(spans, starts, chosen)
    return finite, starts[: bands + 1], chosen


@borrowing
def _simple(now):
    """Whether one chain at most crosses the pixel, without turning back."""
    return (now >> 5) <= 2 and ((now & (RIGHT | LEFT)) != RIGHT | LEFT or (now & (DOWN | UP)) != DOWN | UP)


@borrowing
def sweep(sums, state, state8, base, x0, y0, x1, y1, out, doubtful):
    """Sum along the rows into out (h, w) u1, from x0 on; returns (how many pixels are doubtful, end of the columns written).

    sums, state: of `cut`. Rows that are still covered at x1 are so to the end; elsewhere nothing is written there. Doubtful pixels get
    their sum in the sums and their place (row * columns + column) in doubtful. state8 is state as u8 words: where a word is
    zero, eight pixels have the value of the one before.
    """
    count, end_column = 0, x1
    columns = x1 - x0
    for row in range(y1 - y0):
        total = base
        line = out[y0 + row]
        for word in range(state8.shape[1]):
            begin = 8 * word
            end = min(begin + 8, columns)
            if state8[row, word] == 0:
                value = np.uint8(min(max(total, 0.0), 1.0) * 255.0 + 0.5)
                if end - begin == 8:
                    at = np.uint64(x0 + begin)
                    for k in range(np.uint64(8)):  # a known number of steps becomes one store
                        line[at + k] = value
                else:
                    for column in range(begin, end):
                        line[x0 + column] = value
                continue
            for column in range(begin, end):
                now = state[row, column]
                if now & SUMMED:
                    total += sums[row, column]
                line[x0 + column] = np.uint8(min(max(total, 0.0), 1.0) * 255.0 + 0.5)
                if not _simple(now):
                    sums[row, column] = total
                    doubtful[count] = row * state.shape[1] + column
                    count += 1
        if state[row, columns] & SUMMED:
            total += sums[row, columns]
        value = np.uint8(min(max(total, 0.0), 1.0) * 255.0 + 0.5)
        if value and x1 < out.shape[1]:
            line[x1:] = value
            end_column = out.shape[1]
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
