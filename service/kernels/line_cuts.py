"""Where lines may go out of or come into view: at crossings, in the image, with contours that are not behind them.

A grid of as many cells as there are contour edges has in each cell those that go through it; a line is compared with what is in its
cells. An end that is within TOUCH pixels of a segment counts as on it, and what touches crosses. So a line cannot slip between two edges
of a contour that meet in a vertex, and one that runs along the border of what is before it is cut wherever that begins or ends, however
both are rounded to pixels. A cut that is needless does no harm; so where it is not sure that a contour is behind, it cuts.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from service.kernels.line_image import NEAR0, NEAR1, X0, X1, Y0, Y1

BEHIND = 1e-9
"""Part of a nearness by which a contour must be behind a line not to cut it."""
TOUCH = 1e-9
"""Pixels: a thousand times what rounding takes from a distance in an image of 8192 pixels."""
MOST_CELLS = 1 << 20
REACH = 2.0 * TOUCH
"""Pixels by which a segment's way through the grid is widened: neither a touch nor rounding can hide a cell."""


@njit(cache=True, nogil=True)
def _columns(image, n, row, cell, across):
    """(first, last) columns of a row of cells that segment n may go through."""
    x0, y0, x1, y1 = image[n, X0], image[n, Y0], image[n, X1], image[n, Y1]
    low, high = 0.0, 1.0
    if y0 != y1:
        one = (row * cell - REACH - y0) / (y1 - y0)
        two = ((row + 1) * cell + REACH - y0) / (y1 - y0)
        low, high = max(low, min(one, two)), min(high, max(one, two))
    one, two = x0 + low * (x1 - x0), x0 + high * (x1 - x0)
    first = int(np.floor((min(one, two) - REACH) / cell))
    last = int(np.floor((max(one, two) + REACH) / cell))
    return min(max(first, 0), across - 1), min(max(last, 0), across - 1)


@njit(cache=True, nogil=True)
def _rows(image, n, cell, down):
    first = int(np.floor((min(image[n, Y0], image[n, Y1]) - REACH) / cell))
    last = int(np.floor((max(image[n, Y0], image[n, Y1]) + REACH) / cell))
    return min(max(first, 0), down - 1), min(max(last, 0), down - 1)


@njit(cache=True, nogil=True)
def _grid(contours, width, height):
    """(starts, held, cell, across, down): the contour edges in each cell, row by row."""
    cells = min(max(2 * contours.shape[0], 1), MOST_CELLS)
    cell = np.sqrt(width * height / cells)
    across, down = int(np.ceil(width / cell)), int(np.ceil(height / cell))
    starts = np.zeros(across * down + 1, np.int64)
    held = np.empty(0, np.int32)
    for write in range(2):
        for n in range(contours.shape[0]):
            top, bottom = _rows(contours, n, cell, down)
            for row in range(top, bottom + 1):
                first, last = _columns(contours, n, row, cell, across)
                for column in range(first, last + 1):
                    place = row * across + column
                    if write:
                        starts[place] -= 1
                        held[starts[place]] = n
                    else:
                        starts[place] += 1
        if not write:
            starts = np.cumsum(starts)
            held = np.empty(starts[-1], np.int32)
    return starts, held, cell, across, down


@njit(cache=True, nogil=True)
def _near_at(image, n, s):
    return image[n, NEAR0] + s * (image[n, NEAR1] - image[n, NEAR0])


@njit(cache=True, nogil=True)
def _is_behind(lines, n, s, contours, c, r):
    """Whether contour edge c, at part r, is surely behind line n at part s."""
    line, contour = _near_at(lines, n, s), _near_at(contours, c, r)
    return contour < line - BEHIND * (abs(line) + abs(contour))


@njit(cache=True, nogil=True)
def _foot(image, n, x, y):
    """The part of segment n, 0 to 1, that is closest to a point."""
    dx, dy = image[n, X1] - image[n, X0], image[n, Y1] - image[n, Y0]
    square = dx * dx + dy * dy
    if square == 0.0:
        return 0.0
    return min(1.0, max(0.0, ((x - image[n, X0]) * dx + (y - image[n, Y0]) * dy) / square))


@njit(cache=True, nogil=True)
def _distance(image, n, x, y):
    """The distance of a point from the line of segment n, with a sign; 0 where it is at most TOUCH."""
    dx, dy = image[n, X1] - image[n, X0], image[n, Y1] - image[n, Y0]
    length = np.hypot(dx, dy)
    if length <= TOUCH:
        return 0.0
    distance = (dx * (y - image[n, Y0]) - dy * (x - image[n, X0])) / length
    return distance if abs(distance) > TOUCH else 0.0


@njit(cache=True, nogil=True)
def _cut(lines, n, contours, c, cuts, of, count):
    """count, and the cuts that contour edge c makes in line n, as parts of the line in the image."""
    ax, ay, bx, by = lines[n, X0], lines[n, Y0], lines[n, X1], lines[n, Y1]
    px, py, qx, qy = contours[c, X0], contours[c, Y0], contours[c, X1], contours[c, Y1]
    apart = max(ax, bx) < min(px, qx) - TOUCH or min(ax, bx) > max(px, qx) + TOUCH
    if apart or max(ay, by) < min(py, qy) - TOUCH or min(ay, by) > max(py, qy) + TOUCH:
        return count
    p, q = _distance(lines, n, px, py), _distance(lines, n, qx, qy)
    if p * q > 0.0:
        return count
    if p == 0.0 and q == 0.0:  # one over the other: the ends of the contour edge are cuts
        for end in range(2):
            x, y = (qx, qy) if end else (px, py)
            s = _foot(lines, n, x, y)
            if not _is_behind(lines, n, s, contours, c, float(end)):
                count = _put_cut(cuts, of, count, n, s)
        return count
    a, b = _distance(contours, c, ax, ay), _distance(contours, c, bx, by)
    if a * b > 0.0:
        return count
    s = 0.0 if a == 0.0 else (1.0 if b == 0.0 else a / (a - b))
    r = 0.0 if p == 0.0 else (1.0 if q == 0.0 else p / (p - q))
    if _is_behind(lines, n, s, contours, c, r):
        return count
    return _put_cut(cuts, of, count, n, s)


@njit(cache=True, nogil=True)
def _put_cut(cuts, of, count, n, s):
    if count < cuts.shape[0]:
        cuts[count], of[count] = s, n
    return count + 1


@njit(cache=True, nogil=True)
def find_cuts(lines, nodes, contours, contour_nodes, width, height, most, cuts, of):
    """How many cuts there are, or more than `most` where there are more; the first of them in cuts (k,) f8, parts of the line of (k,) i4.

    lines (n, COLUMNS), contours (c, COLUMNS) f8: `line_image.project_segments`; nodes (n, 2), contour_nodes (c, 2) i4: what their ends
    are. Where the two share an end, that is no crossing. Parts are those in the image. Some cuts may come twice.
    """
    starts, held, cell, across, down = _grid(contours, width, height)
    last_line = np.full(contours.shape[0], -1, np.int32)
    count = 0
    for n in range(lines.shape[0]):
        if count > most:
            break
        top, bottom = _rows(lines, n, cell, down)
        for row in range(top, bottom + 1):
            first, last = _columns(lines, n, row, cell, across)
            for column in range(first, last + 1):
                place = row * across + column
                for i in range(starts[place], starts[place + 1]):
                    c = held[i]
                    if last_line[c] == n:
                        continue
                    last_line[c] = n
                    p, q = contour_nodes[c, 0], contour_nodes[c, 1]
                    if nodes[n, 0] == p or nodes[n, 0] == q or nodes[n, 1] == p or nodes[n, 1] == q:
                        continue
                    count = _cut(lines, n, contours, c, cuts, of, count)
    return count
