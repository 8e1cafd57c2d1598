"""Lines cut into pieces over which visibility does not change, and what joins such pieces at the vertices of the mesh."""

from __future__ import annotations

import numpy as np
from numba import njit

from geometry.predicates import orient_sign
from service.kernels.line_image import T0, T1, X0, X1, Y0, Y1, across
from service.kernels.line_kinds import corner

SHORTEST_PX = 1e-7
"""Cuts nearer to each other in the image are one, and a shorter line is a point."""
START, END = 1, 2
"""Bits of a piece's `free`: it goes on to the end of its line there, and nothing in front passes just there."""


@njit(cache=True, nogil=True)
def _sort_rows(starts, values):
    """Sort values[starts[i]:starts[i + 1]] for every i; the rows are short."""
    for i in range(starts.shape[0] - 1):
        for j in range(starts[i] + 1, starts[i + 1]):
            value, k = values[j], j
            while k > starts[i] and values[k - 1] > value:
                values[k] = values[k - 1]
                k -= 1
            values[k] = value


@njit(cache=True, nogil=True)
def cuts_by_line(lines, found, of, edges, pierced_starts, pierced_at):
    """(starts (n + 1,) i8, cuts): for each line its cuts in ascending order, parts of it in the image.

    found (k,) f8, of (k,) i4: cuts by contours and their lines. edges (n,) i4: which edge of the mesh or intersection a line is;
    pierced_at[pierced_starts[e]:pierced_starts[e + 1]]: where faces go through that, parts of it in space.
    """
    starts = np.zeros(lines.shape[0] + 1, np.int64)
    for k in range(of.shape[0]):
        starts[of[k] + 1] += 1
    for n in range(lines.shape[0]):
        for k in range(pierced_starts[edges[n]], pierced_starts[edges[n] + 1]):
            starts[n + 1] += lines[n, T0] <= pierced_at[k] <= lines[n, T1]
    starts = np.cumsum(starts)
    place, cuts = starts[:-1].copy(), np.empty(starts[-1])
    for k in range(of.shape[0]):
        cuts[place[of[k]]] = found[k]
        place[of[k]] += 1
    for n in range(lines.shape[0]):
        for k in range(pierced_starts[edges[n]], pierced_starts[edges[n] + 1]):
            if lines[n, T0] <= pierced_at[k] <= lines[n, T1]:
                cuts[place[n]] = across(lines, n, pierced_at[k])
                place[n] += 1
    _sort_rows(starts, cuts)
    return starts, cuts


@njit(cache=True, nogil=True)
def cut_lines(lines, starts, cuts):
    """(line (p,) i4, spans (p, 2) f8, free (p,) u1): the pieces, parts of their lines in the image, in order along each line.

    starts, cuts: `cuts_by_line`. A line that is a point in the image is no piece.
    """
    most = lines.shape[0] + cuts.shape[0]
    line, spans, free = np.empty(most, np.int32), np.empty((most, 2)), np.empty(most, np.uint8)
    count = 0
    for n in range(lines.shape[0]):
        length = np.hypot(lines[n, X1] - lines[n, X0], lines[n, Y1] - lines[n, Y0])
        if length <= SHORTEST_PX:
            continue
        least, begin = SHORTEST_PX / length, 0.0
        bits = START if lines[n, T0] == 0.0 else 0
        last = END if lines[n, T1] == 1.0 else 0
        for k in range(starts[n], starts[n + 1]):
            cut = cuts[k]
            if cut - begin <= least:
                if begin == 0.0:
                    bits = 0
                continue
            if 1.0 - cut <= least:
                last = 0
                break
            line[count], spans[count, 0], spans[count, 1], free[count] = n, begin, cut, bits
            count += 1
            begin, bits = cut, 0
        line[count], spans[count, 0], spans[count, 1], free[count] = n, begin, 1.0, bits | last
        count += 1
    return line[:count].copy(), spans[:count].copy(), free[:count].copy()


@njit(cache=True, nogil=True)
def hidden_at(positions, faces, sides, eye, ring_starts, ring, v, w):
    """Whether a face about vertex v hides the beginning of its edge to vertex w, exactly.

    A face v, i, j does when its plane has the beginning on one side and the eye strictly on the other, and in the image the edge starts
    between the sides to i and to j, one of which it may be.
    """
    x, y, z, infinite = eye[0], eye[1], eye[2], eye[3]
    at, to = corner(positions, v), corner(positions, w)
    for k in range(ring_starts[v], ring_starts[v + 1]):
        f = ring[k]
        side = np.int64(sides[f])
        if side == 0:
            continue
        first = 0 if faces[f, 0] == v else (1 if faces[f, 1] == v else 2)
        i, j = faces[f, (first + 1) % 3], faces[f, (first + 2) % 3]
        if i == w or j == w:
            continue
        a, b = corner(positions, i), corner(positions, j)
        if orient_sign(at, a, b, to[0], to[1], to[2], 1.0) * side >= 0:
            continue
        if orient_sign(at, a, to, x, y, z, infinite) * side >= 0 and orient_sign(at, to, b, x, y, z, infinite) * side >= 0:
            return True
    return False
