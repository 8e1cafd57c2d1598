"""How far a surface is from another at most: a certified upper bound, by branch and bound.

The distance to a convex set is a convex function. So for a triangle T and any one triangle t of the other surface, no point
of T is further from that surface than T's furthest corner is from t. Where the least such bound of a few t (those closest to
T's corners and to the middle of its longest side) is not good enough, T is cut in two there. What counts is the largest
distance of all, so T is done as soon as its bound is hardly above the largest distance that some point has been seen to have.

Everything is float64, squared distances. `closest_on_triangle` evaluates the distance to a point of t (up to rounding), never
less, so a computed bound is short of a true one by rounding only: coordinates are below 4, each of some 20 operations loses at
most 4 x 2^-53 of an absolute value below 16, and a middle is off the side it halves by as much, once for each of MOST_DEPTH
cuts. That is below 1e-12 in all; `worker.distance` adds it.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from geometry.borrowing import borrowing
from geometry.boxes import STACK
from worker.kernels.bake_boxes import closest_face, closest_on_triangle

LOW, HIGH, CUTS_LEFT = 0, 1, 2
"""Entries of a state (3,) f8: largest squared distance of a point seen, largest squared bound of a piece done, cuts left."""
USUAL_VISITS = 64
"""Nodes that a search for a closest face looks into; one that looks into more, as about a vertex of very many edges, counts as so
many cuts."""
MOST_DEPTH = 60
"""Cuts from a face to a piece at most; 60 halve all three sides twenty times."""


@njit(cache=True, nogil=True)
def nearest_faces(positions, faces, order, boxes, points, begin, end, closest, state):
    """closest (n,) i4: the face closest to each of points[begin:end], (n, 3) f4; raises state[LOW]."""
    stack, near = np.empty(STACK, np.int64), np.empty(STACK)
    known = np.int64(0) if begin == 0 else np.int64(closest[begin - 1])
    for n in range(begin, end):
        x, y, z = np.float64(points[n, 0]), np.float64(points[n, 1]), np.float64(points[n, 2])
        square, known, _, _, _ = closest_face(positions, faces, order, boxes, x, y, z, known, stack, near)
        closest[n] = known
        state[LOW] = max(state[LOW], square)


@borrowing
def _furthest_corner(positions, faces, face, piece, least):
    """Square of the distance of the furthest corner of a piece (9,) f8 from a face, or infinity when it is not below least."""
    a, b, c = positions[faces[face, 0]], positions[faces[face, 1]], positions[faces[face, 2]]
    furthest = 0.0
    for k in range(3):
        square, _, _ = closest_on_triangle(a, b, c, piece[3 * k], piece[3 * k + 1], piece[3 * k + 2])
        furthest = max(furthest, square)
        if furthest >= least:
            return np.inf
    return furthest


@borrowing
def _longest_side(piece):
    """Corner k such that the side from k to k + 1 is the longest."""
    longest, best = 0, -1.0
    for k in range(3):
        square = 0.0
        for axis in range(3):
            square += (piece[3 * ((k + 1) % 3) + axis] - piece[3 * k + axis]) ** 2
        if square > best:
            longest, best = k, square
    return longest


@njit(cache=True, nogil=True)
def bound_faces(positions, faces, order, boxes, points, triangles, closest, bounds, begin, end, gap, floor, state):
    """Bound the distance of triangles[begin:end] (m, 3) i4 of points (n, 3) f4; raises state[HIGH] and state[LOW], lowers bounds.

    closest: of `nearest_faces`, for all points. bounds (m,) f8: squared bound of each triangle, as far as it is known. gap, floor:
    a piece is done when its bound is below (1 + gap) times the largest distance seen, or below floor; or when state[CUTS_LEFT] or
    MOST_DEPTH is used up. A triangle whose known bound is low enough is not searched again.
    """
    stack, near = np.empty(STACK, np.int64), np.empty(STACK)
    pieces = np.empty((MOST_DEPTH + 2, 9))
    owners = np.empty((MOST_DEPTH + 2, 3), np.int64)
    depths = np.empty(MOST_DEPTH + 2, np.int64)
    factor = (1.0 + gap) ** 2
    for f in range(begin, end):
        if bounds[f] <= max(factor * state[LOW], floor * floor):
            state[HIGH] = max(state[HIGH], bounds[f])
            continue
        for k in range(3):
            v = triangles[f, k]
            owners[0, k] = closest[v]
            for axis in range(3):
                pieces[0, 3 * k + axis] = points[v, axis]
        depths[0], top, furthest = 0, 1, 0.0
        while top > 0:
            row = top - 1
            piece, owner = pieces[row], owners[row]
            enough = max(factor * state[LOW], floor * floor)
            bound = np.inf
            for k in range(3):
                if bound > enough and (k == 0 or owner[k] != owner[k - 1]):
                    bound = min(bound, _furthest_corner(positions, faces, owner[k], piece, bound))
            if bound > enough:
                k = _longest_side(piece)
                i, j = 3 * k, 3 * ((k + 1) % 3)
                x, y, z = 0.5 * (piece[i] + piece[j]), 0.5 * (piece[i + 1] + piece[j + 1]), 0.5 * (piece[i + 2] + piece[j + 2])
                square, face, _, _, visits = closest_face(positions, faces, order, boxes, x, y, z, owner[k], stack, near)
                state[LOW] = max(state[LOW], square)
                bound = min(bound, _furthest_corner(positions, faces, face, piece, bound))
                enough = max(factor * state[LOW], floor * floor)
                if bound > enough and state[CUTS_LEFT] > 0 and depths[row] < MOST_DEPTH:
                    state[CUTS_LEFT] -= max(1, visits // USUAL_VISITS)
                    depths[row] += 1
                    pieces[top], owners[top], depths[top] = piece, owner, depths[row]
                    # the half in this row gives up corner k + 1, the half in the next one corner k
                    j = (k + 1) % 3
                    pieces[row, 3 * j], pieces[row, 3 * j + 1], pieces[row, 3 * j + 2], owners[row, j] = x, y, z, face
                    pieces[top, 3 * k], pieces[top, 3 * k + 1], pieces[top, 3 * k + 2], owners[top, k] = x, y, z, face
                    top += 1
                    continue
            furthest = max(furthest, bound)
            top -= 1
        bounds[f] = min(bounds[f], furthest)
        state[HIGH] = max(state[HIGH], bounds[f])
