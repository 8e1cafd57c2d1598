r"""Half-edges of a closed oriented mesh under edge collapses.

Half-edge h = 3 f + k runs from corner k to corner k + 1 of face f, whose left it bounds. The collapse of a -> b moves a to the
new position and merges b into it; faces (a, b, c) and (b, a, d) vanish:

              c                        c
            / | \                    / | \
         p / f1  \ q              p /  |  \ q
        - a --h--> b -    ==>    - - - a - - -          F(i+1): all faces around a or b    F(i): all faces around the new a
           \ f2  /                  \  |  /
            \ | /                    \ | /
              d                        d
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from geometry.borrowing import borrowing

FAN_LIMIT = 512
"""Faces around an edge; where there are more, the edge is not collapsed (until collapses beside it have made it fewer)."""


class CollapseMesh(NamedTuple):
    """Arrays of v vertices, f faces, e edges; gone elements keep their slots.

    positions: (v, 3) f8 with float32 values. corner: (3 f,) i4, vertex where the half-edge starts. opposite: (3 f,) i4.
    edge: (3 f,) i4, edge of the half-edge. half: (e,) i4, a half-edge of the edge, -1 when gone. out: (v,) i4, a half-edge that
    starts at the vertex. locked: (v,) bool, vertices whose faces are not one fan. stamp: (v,) i8 scratch of the ring search.
    """

    positions: np.ndarray
    corner: np.ndarray
    opposite: np.ndarray
    edge: np.ndarray
    half: np.ndarray
    out: np.ndarray
    locked: np.ndarray
    stamp: np.ndarray


def build_collapse_mesh(positions: np.ndarray, faces: np.ndarray, edge_vertices: np.ndarray, edge_faces: np.ndarray) -> CollapseMesh:
    """positions (v, 3) f4, faces (f, 3) i4 and the edge table of `geometry.topology.build_edges`."""
    corner = np.ascontiguousarray(faces, np.int32).reshape(-1)
    left = _half_edges(faces, edge_faces[:, 0], edge_vertices[:, 0])
    right = _half_edges(faces, edge_faces[:, 1], edge_vertices[:, 1])
    opposite, edge = np.empty(len(corner), np.int32), np.empty(len(corner), np.int32)
    opposite[left], opposite[right] = right, left
    edge[left] = edge[right] = np.arange(len(left), dtype=np.int32)
    out = np.full(len(positions), -1, np.int32)
    out[corner] = np.arange(len(corner), dtype=np.int32)
    degree = np.bincount(corner, minlength=len(positions))
    locked = _fans(opposite, out) != degree
    stamp = np.zeros(len(positions), np.int64)
    return CollapseMesh(np.array(positions, np.float64), corner.copy(), opposite, edge, left.copy(), out, locked, stamp)


def _half_edges(faces: np.ndarray, face: np.ndarray, start: np.ndarray) -> np.ndarray:
    """Half-edge of each face that starts at the given vertex."""
    return (3 * face + np.argmax(faces[face] == start[:, None], axis=1)).astype(np.int32)


@njit(cache=True, inline="always")
def following(h):
    """Next half-edge around the face."""
    return h - 2 if h % 3 == 2 else h + 1


@njit(cache=True, inline="always")
def preceding(h):
    """Previous half-edge around the face."""
    return h + 2 if h % 3 == 0 else h - 1


@njit(cache=True)
def _fans(opposite, out):
    """(v,) faces met by walking around each vertex once."""
    met = np.zeros(out.shape[0], np.int64)
    for v in range(out.shape[0]):
        h = out[v]
        if h < 0:
            continue
        g = h
        while True:
            met[v] += 1
            g = opposite[preceding(g)]
            if g == h:
                break
    return met


@borrowing
def gather_fan(opposite, h, fan):
    """Faces around either end of h as half-edges that start at a or b; returns (count, count at a), count -1 when too many.

    fan[0] = h (face f1) and fan[count_a - 1] (face f2) vanish; the others survive the collapse.
    """
    n = 0
    g = h
    while True:
        if n == FAN_LIMIT:
            return -1, 0
        fan[n] = g
        n += 1
        g = opposite[preceding(g)]
        if g == h:
            break
    count_a = n
    last = following(h)
    g = opposite[preceding(opposite[h])]
    while g != last:
        if n == FAN_LIMIT:
            return -1, 0
        fan[n] = g
        n += 1
        g = opposite[preceding(g)]
    return n, count_a


@borrowing
def keeps_topology(mesh, fan, count, count_a, mark):
    """Link condition: the ends share exactly the two vertices opposite to the edge, and are no tetrahedron's.

    mark: a number that was never used for this mesh's stamp.
    """
    if count_a < 3 or count == count_a:
        return False  # a vertex between two faces back to back
    if count_a == 3 and count - count_a == 1:
        return False
    for k in range(count_a):
        mesh.stamp[mesh.corner[following(fan[k])]] = mark
    # the second fan runs from d to c: between them no vertex may be a neighbour of a
    shared = 0
    for k in range(count_a + 1, count):
        if mesh.stamp[mesh.corner[following(fan[k])]] == mark:
            shared += 1
    return shared == 0


@borrowing
def collapse(mesh, fan, count, count_a):
    """Merge b into a; positions are left alone. Returns the two edges that are gone beside the collapsed one."""
    corner, opposite, edge, half, out = mesh.corner, mesh.opposite, mesh.edge, mesh.half, mesh.out
    h = fan[0]
    a = corner[h]
    for k in range(count_a, count):
        corner[fan[k]] = a
    half[edge[h]] = -1
    lost_left = _zip(corner, opposite, edge, half, out, following(h), preceding(h))
    o = opposite[h]
    lost_right = _zip(corner, opposite, edge, half, out, preceding(o), following(o))
    # any surviving face of a
    out[a] = fan[1]
    return lost_left, lost_right


@borrowing
def _zip(corner, opposite, edge, half, out, from_b, from_a):
    """Glue the outer neighbours of a vanishing face's two other half-edges; the edge at a survives, that at b is returned."""
    x, y = opposite[from_b], opposite[from_a]
    kept, lost = edge[from_a], edge[from_b]
    opposite[x], opposite[y] = y, x
    edge[x] = edge[y] = kept
    half[kept] = y
    half[lost] = -1
    # the apex (c or d) must not point into the vanished face
    for g in (x, y):
        out[corner[g]] = g
    return lost
