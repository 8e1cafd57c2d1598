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

from geometry.borrowing import borrowing
from service.kernels.coverage import LISTED

EXACT_PIECES = 8
SLABS = 20
LANES = 4  # numbers in a register
ANY_ORDER = {"reassoc", "nnan", "nsz"}  # sums of whole numbers, which come out the same in any order
STEEPEST = 1e5  # dx / dy up to which x = a + b y is good to NEAR
NEAR = 1e-9  # pixels
# rows of scratch
HEIGHT, LOW, HIGH, AT, RUN, SIGN, LOW_X, HIGH_X, OWN, EVENT, STEP, X, SIDE, WINDING = range(14)
ROWS = 14


@borrowing
def _insert(scratch, n, y):
    """Put y into the sorted row HEIGHT of scratch unless it is there; returns how many there are now."""
    j = n
    while j > 0 and scratch[HEIGHT, j - 1] > y:
        j -= 1
    if j > 0 and scratch[HEIGHT, j - 1] == y:
        return n
    for i in range(n, j, -1):
        scratch[HEIGHT, i] = scratch[HEIGHT, i - 1]
    scratch[HEIGHT, j] = y
    return n + 1


@borrowing
def _heights(p, begin, end, top, scratch):
    """Heights of interest of pieces p[begin:end], sorted, each once, into row HEIGHT; returns how many."""
    scratch[HEIGHT, 0], scratch[HEIGHT, 1] = top, top + 1.0
    n = 2
    for i in range(begin, end):
        n = _insert(scratch, n, p[i, 1])
        n = _insert(scratch, n, p[i, 3])
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
                n = _insert(scratch, n, p[i, 1] + dy * (third / (third - fourth)))
    return n


@borrowing
def _lines(p, begin, end, total, left, top, scratch):
    """Prepare pieces p[begin:end] for the others, relative to the pixel's corner; returns (events, winding number in that corner).

    Rows of scratch: LOW, HIGH heights of a piece, AT and RUN: its x = AT + y * RUN, SIGN +1 where it runs down, -1 up or 0 level;
    HIGH_X and LOW_X: x of its ends at HIGH and LOW; OWN: what it adds to the integral of the winding number over the pixel, given
    that just left of the pixel's top left corner; EVENT, STEP: heights and steps of the winding number on the pixel's left side. The
    winding number in the corner is what is left of the pixel's sum without its own pieces.
    """
    events, rest = np.uint64(0), total
    for i in range(np.uint64(end - begin)):
        q = np.uint64(begin) + i
        xa, ya, xb, yb = p[q, 0] - left, p[q, 1] - top, p[q, 2] - left, p[q, 3] - top
        down = yb > ya
        run = (xb - xa) / (yb - ya) if yb != ya else 0.0
        scratch[LOW, i], scratch[HIGH, i] = min(ya, yb), max(ya, yb)
        scratch[AT, i], scratch[RUN, i] = xa - ya * run, run
        scratch[SIGN, i] = (yb > ya) * 1.0 - (yb < ya) * 1.0
        scratch[LOW_X, i], scratch[HIGH_X, i] = xa if down else xb, xb if down else xa
        # a chain that comes in through the left side runs to the right: below it the winding is less by one
        enters, leaves = (xa == 0.0) * 1.0, (xb == 0.0) * 1.0
        own = (yb - ya) * (1.0 - 0.5 * (xa + xb)) - enters * (1.0 - ya) + leaves * (1.0 - yb)
        scratch[OWN, i] = own
        rest -= own
        scratch[EVENT, events], scratch[STEP, events] = ya, -1.0
        events += np.uint64(xa == 0.0)
        scratch[EVENT, events], scratch[STEP, events] = yb, 1.0
        events += np.uint64(xb == 0.0)
    return events, np.floor(rest + 0.5)


@njit(cache=True, nogil=True, error_model="numpy", fastmath=ANY_ORDER)
def _winding_left_of(x, i, n, scratch):
    """What the crossings before crossing i, at x, add to the winding number: those further left, and of those at x the first."""
    winding = 0.0
    for j in range(n):
        winding += scratch[SIDE, j] if (scratch[X, j] < x) | ((scratch[X, j] == x) & (j < i)) else 0.0
    return winding


@borrowing
def _width(count, events, y, corner, scratch):
    """Covered width on the line y of the pixel: where the winding number becomes positive and where it ceases to be.

    No branch depends on where a piece is, and nothing is sorted: those branches would be guessed wrongly.
    """
    winding, n = corner, np.uint64(0)
    for i in range(events):
        winding += scratch[STEP, i] * (scratch[EVENT, i] < y)
    for i in range(np.uint64(count)):
        scratch[X, n] = min(max(scratch[AT, i] + y * scratch[RUN, i], 0.0), 1.0)
        scratch[SIDE, n] = scratch[SIGN, i]
        n += np.uint64((scratch[LOW, i] < y) & (y < scratch[HIGH, i]))
    covered, last = 0.0, winding
    for i in range(n):
        x, step = scratch[X, i], scratch[SIDE, i]
        before = winding + _winding_left_of(x, i, n, scratch)
        covered += x * ((before > 0.0) * 1.0 - (before + step > 0.0) * 1.0)
        last += step
    return covered + (last > 0.0)


@njit(cache=True, nogil=True, error_model="numpy", fastmath=ANY_ORDER)
def _against(i, n, y, x, scratch):
    """Piece i against all others: (winding number that those left of its middle (x, y) add, the least that meetings add to the
    winding number beside it, how many meetings).

    Piece j counts where it is on the left of i, and where they meet it changes sides: where j runs past the middle of i both cases are
    known, else the chain of j goes on there, and a meeting changes the winding number by one. Two ends at the same place are no meeting;
    an end within NEAR of another piece is, as its chain may go on across.
    """
    low_i, high_i, at_i, run_i = scratch[LOW, i], scratch[HIGH, i], scratch[AT, i], scratch[RUN, i]
    low_x, high_x = scratch[LOW_X, i], scratch[HIGH_X, i]
    winding = least = meetings = 0.0
    for j in range(n):
        low_j, high_j, sign_j = scratch[LOW, j], scratch[HIGH, j], scratch[SIGN, j]
        low, high = max(low_i, low_j), min(high_i, high_j)
        shift, slope = at_i - scratch[AT, j], run_i - scratch[RUN, j]
        above, below = shift + slope * low, shift + slope * high
        least_gap, most_gap = min(above, below), max(above, below)
        meet = ~(((most_gap > NEAR) & (least_gap > -NEAR)) | ((least_gap < -NEAR) & (most_gap < NEAR)))
        meet |= (abs(above) <= NEAR) & ((low_i != low_j) | (low_x != scratch[LOW_X, j]))
        meet |= (abs(below) <= NEAR) & ((high_i != high_j) | (high_x != scratch[HIGH_X, j]))
        meet &= (low < high) & (i != j)
        past = (low_j <= y) & (y < high_j)
        counted = sign_j if past & (scratch[AT, j] + y * scratch[RUN, j] < x) & (i != j) else 0.0
        winding += counted
        change = min(sign_j, 0.0) - counted if past else -1.0
        least += change if meet else 0.0
        meetings += 1.0 if meet else 0.0
    return winding, least, meetings


@borrowing
def _beside(count, events, corner, scratch):
    """(meetings, least): twice how many pairs of pieces cross or run on top of each other, -1 when a piece is too flat to tell; and a
    lower bound of the winding number in the pixel.

    Row WINDING of scratch gets the winding number just left of the middle of each piece. Every part of the pixel has a piece on its
    border; from the middle of the piece to there the winding number beside it changes only where it meets others.
    """
    meetings, least = 0.0, np.inf
    n = np.uint64(count if count < LANES else (count + LANES - 1) // LANES * LANES)
    for i in range(np.uint64(count), n):  # filled up, as lanes are compared together, with pieces that nothing meets
        scratch[LOW, i], scratch[HIGH, i], scratch[AT, i], scratch[RUN, i] = 4.0, -4.0, 0.0, 0.0
        scratch[SIGN, i], scratch[LOW_X, i], scratch[HIGH_X, i] = 0.0, 0.0, 0.0
    for i in range(np.uint64(count)):
        if not abs(scratch[RUN, i]) < STEEPEST or scratch[LOW, i] == scratch[HIGH, i]:
            return -1.0, least
        y = 0.5 * (scratch[LOW, i] + scratch[HIGH, i])
        x = scratch[AT, i] + y * scratch[RUN, i]
        winding = corner
        for e in range(events):
            winding += scratch[STEP, e] * (scratch[EVENT, e] <= y)
        added, change, met = _against(i, n, y, x, scratch)
        winding += added
        meetings += met
        scratch[WINDING, i] = winding
        least = min(least, winding + min(scratch[SIGN, i], 0.0) + change)
    return meetings, least


@borrowing
def _area_between(count, corner, scratch):
    """Covered area of a pixel whose pieces do not meet: the integral of the winding number over the pieces that bound it.

    Along a piece that meets no other the winding number on either side is the same from end to end. Pieces with 0 on one side
    and 1 on the other are the border of what is covered.
    """
    area = 1.0 if corner > 0.0 else 0.0
    for i in range(np.uint64(count)):
        winding = scratch[WINDING, i]
        area += scratch[OWN, i] * (min(winding, winding + scratch[SIGN, i]) == 0.0)
    return area


@borrowing
def covered_area(p, begin, end, total, left, top, scratch):
    """Area of the pixel (left, top) in which the winding number is positive.

    p[begin:end] (k, 4) f8: its pieces. total: the integral of the winding number over the pixel. scratch: (ROWS, n) f8, n at
    least 2 k + LANES and at least 2 + 2 m + m^2 with m = min(k, EXACT_PIECES).
    """
    count = end - begin
    events, corner = _lines(p, begin, end, total, left, top, scratch)
    meetings, least = _beside(count, events, corner, scratch)
    if meetings >= 0:
        if least > 0.0:
            return 1.0
        if meetings == 0:
            return _area_between(count, corner, scratch)
    area = 0.0
    if count > EXACT_PIECES:
        for i in range(SLABS):
            area += _width(count, events, (i + 0.5) / SLABS, corner, scratch)
        return area / SLABS
    n = _heights(p, begin, end, top, scratch)
    for i in range(n - 1):
        y = 0.5 * ((scratch[HEIGHT, i] - top) + (scratch[HEIGHT, i + 1] - top))
        area += _width(count, events, y, corner, scratch) * (scratch[HEIGHT, i + 1] - scratch[HEIGHT, i])
    return area


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


@njit(cache=True, nogil=True)
def resolve(pieces, offsets, most, doubtful, sums, columns, mask, x0, y0):
    """Replace the mask of every doubtful pixel by its covered area. sums: flat, `columns` numbers a row; the rest as `gather`."""
    few = min(most, EXACT_PIECES)
    scratch = np.empty((ROWS, max(2 * most + LANES, 2 + 2 * few + few * few)))
    for d in range(doubtful.shape[0]):
        row, column = doubtful[d] // columns, doubtful[d] % columns
        left, top = np.float64(x0 + column), np.float64(y0 + row)
        area = covered_area(pieces, offsets[d], offsets[d + 1], sums[doubtful[d]], left, top, scratch)
        mask[y0 + row, x0 + column] = np.uint8(min(max(area, 0.0), 1.0) * 255.0 + 0.5)
