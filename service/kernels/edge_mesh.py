"""Edges with the vertices opposite to them, and by how much they fold.

Names of the four vertices of an edge (the order is that of GL's lines with adjacency):

          b = 2
         /|\\
    0   / | \\   3        face a, b, 0 is the left one, seen from outside; face b, a, 3 the right one
        \\ | /
         \\|/
          a = 1
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from geometry.predicates import orient_sign

MOST_AROUND = 64
"""Faces around one line that are put in order: it takes the square of their number."""
LEAST_ANGLE = np.float32(1e-30)
"""Degrees: kept instead of a zero where the exact sign says that the edge is not flat."""


@njit(cache=True, nogil=True)
def opposite_vertices(faces, edge_vertices, edge_faces):
    """(e, 4) i4: vertex opposite on the left face, the edge's ends, vertex opposite on the right face, of edges with two faces each.

    faces (f, 3) i4; edge_vertices, edge_faces (e, 2) i4 as in `geometry.topology.EdgeTable`.
    """
    out = np.empty((edge_vertices.shape[0], 4), np.int32)
    for e in range(edge_vertices.shape[0]):
        a, b = edge_vertices[e, 0], edge_vertices[e, 1]
        left, right = edge_faces[e, 0], edge_faces[e, 1]
        out[e, 0] = faces[left, 0] + faces[left, 1] + faces[left, 2] - a - b
        out[e, 1], out[e, 2] = a, b
        out[e, 3] = faces[right, 0] + faces[right, 1] + faces[right, 2] - a - b
    return out


@njit(cache=True)
def _cross(u, v, out):
    for k in range(3):
        i, j = (k + 1) % 3, (k + 2) % 3
        out[k] = u[i] * v[j] - u[j] * v[i]


@njit(cache=True)
def _dot(u, v):
    return u[0] * v[0] + u[1] * v[1] + u[2] * v[2]


@njit(cache=True, nogil=True)
def edge_angles(positions, edges):
    """(e,) f4 degrees by which the normals turn across each edge: above 0 where it is convex, below where it is concave, with the exact
    sign; 0 where it is flat, or at a border, or beside a face without area; 180 where two faces lie on each other.

    positions (v, 3) f4; edges (e, 4) i4 as drawn above; at a border 3 is 1.
    """
    out = np.zeros(edges.shape[0], np.float32)
    along, left, right = np.empty(3), np.empty(3), np.empty(3)
    n, m, c = np.empty(3), np.empty(3), np.empty(3)
    for e in range(edges.shape[0]):
        o, a, b, q = edges[e]
        if q == a:
            continue
        for k in range(3):
            start = np.float64(positions[a, k])
            along[k] = np.float64(positions[b, k]) - start
            left[k] = np.float64(positions[o, k]) - start
            right[k] = np.float64(positions[q, k]) - start
        _cross(along, left, n)
        _cross(right, along, m)
        # normals of unit length: those of tiny faces would lose their product to underflow
        length, other = math.sqrt(_dot(n, n)), math.sqrt(_dot(m, m))
        if length == 0.0 or other == 0.0:
            continue
        for k in range(3):
            n[k] /= length
            m[k] /= other
        _cross(n, m, c)
        angle = np.float32(math.degrees(math.atan2(math.sqrt(_dot(c, c)), _dot(n, m))))
        p = positions[q]
        sign = orient_sign(positions[a], positions[b], positions[o], np.float64(p[0]), np.float64(p[1]), np.float64(p[2]), 1.0)
        if sign == 0:
            out[e] = 180.0 if angle > 90.0 else 0.0
        else:
            out[e] = -sign * max(angle, LEAST_ANGLE)
    return out


@njit(cache=True)
def _side(positions, a, b, o, q):
    """1 when the vertex q is less than half a turn after o around a -> b, -1 when before, 0 in the same plane; exact."""
    p = positions[q]
    return orient_sign(positions[a], positions[b], positions[o], np.float64(p[0]), np.float64(p[1]), np.float64(p[2]), 1.0)


@njit(cache=True)
def _is_opposite(positions, a, b, o, q):
    """Whether q, in the plane of a, b and o, is on the other side of the line from o; float64 is sure of that but for needles."""
    along, to_o, to_q, n, m = np.empty(3), np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    for k in range(3):
        start = np.float64(positions[a, k])
        along[k] = np.float64(positions[b, k]) - start
        to_o[k] = np.float64(positions[o, k]) - start
        to_q[k] = np.float64(positions[q, k]) - start
    _cross(along, to_o, n)
    _cross(along, to_q, m)
    return _dot(n, m) < 0.0


@njit(cache=True)
def _order_around(positions, a, b, opposite):
    """(n,) i8: the vertices opposite (n,) to a line in their order around a -> b, the first one first."""
    n = opposite.shape[0]
    order, quarters = np.zeros(n, np.int64), np.zeros(n, np.int64)
    for i in range(1, n):
        side = _side(positions, a, b, opposite[0], opposite[i])
        quarter = 2 - side  # 0 at the first, 1 in the half turn after it, 2 opposite, 3 in the half turn before it
        if side == 0 and not _is_opposite(positions, a, b, opposite[0], opposite[i]):
            quarter = 0
        j = i
        while j > 0 and (
            quarter < quarters[j - 1]
            or (quarter == quarters[j - 1] and quarter % 2 == 1 and _side(positions, a, b, opposite[i], opposite[order[j - 1]]) > 0)
        ):
            order[j], quarters[j] = order[j - 1], quarters[j - 1]
            j -= 1
        order[j], quarters[j] = i, quarter
    return order


@njit(cache=True)
def _put(out, count, o, a, b, q):
    out[count, 0], out[count, 1], out[count, 2], out[count, 3] = o, a, b, q
    return count + 1


@njit(cache=True)
def _pair_around(positions, half, opposite, run, out, count):
    """Edges of one line a -> b that more than two faces have, into out from `count`; the new count.

    Faces in their order around the line: one that has it as a -> b has the solid before it, so it goes with the one before, if that has
    it as b -> a. What finds no partner is a border; so are all faces of a line that has more than MOST_AROUND.
    """
    n = run.shape[0]
    a, b = min(half[run[0], 0], half[run[0], 1]), max(half[run[0], 0], half[run[0], 1])
    taken = np.zeros(n, np.bool_)
    if n <= MOST_AROUND:
        order = _order_around(positions, a, b, opposite[run])
        for i in range(n):
            here, before = order[i], order[i - 1]
            if half[run[here], 0] == a and half[run[before], 0] == b:
                taken[here] = taken[before] = True
                count = _put(out, count, opposite[run[here]], a, b, opposite[run[before]])
    for i in range(n):
        if not taken[i]:
            h = run[i]
            count = _put(out, count, opposite[h], half[h, 0], half[h, 1], half[h, 0])
    return count


@njit(cache=True, nogil=True)
def edges_of_any(positions, half, opposite, key, order):
    """(e, 4) i4, as `opposite_vertices`, of triangles that need not be closed, oriented or two an edge; at a border 3 is 1.

    Two faces that run along an edge the same way are taken as if the second were turned over. More than two at an edge are paired so
    that each pair bounds a piece of the solid (`_pair_around`).
    positions (v, 3) f4; half (3 f, 2) i4: directed edges of the faces; opposite (3 f,) i4: the face's third vertex; key (3 f,) i8: the
    same for the same two ends; order (3 f,) i8: by key.
    """
    out = np.empty((half.shape[0], 4), np.int32)
    count = start = 0
    while start < order.shape[0]:
        end = start + 1
        while end < order.shape[0] and key[order[end]] == key[order[start]]:
            end += 1
        first = order[start]
        a, b = half[first, 0], half[first, 1]
        if end - start == 1:
            count = _put(out, count, opposite[first], a, b, a)
        elif end - start == 2:
            count = _put(out, count, opposite[first], a, b, opposite[order[start + 1]])
        else:
            count = _pair_around(positions, half, opposite, order[start:end], out, count)
        start = end
    return out[:count].copy()
