"""By how much outlines turn where two of their edges meet, in the image: how far round a corner a stroke must go.

            outwards        turn > 0: the strokes gape, and the corner is theirs
        ___i____
                \\  j
surface          \\         turn < 0: they overlap
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

UNKNOWN = 10.0
"""Radians: where an edge has no neighbour that is drawn, or more than one."""


@njit(cache=True, nogil=True)
def turns_at_ends(matrix, nearest, flip, positions, ends, turns):
    """Into turns (n, 2) f8 radians, above 0 where the outline turns outwards: at both ends of the edges in ends (n, 4) i4.

    matrix: (4, 4) f8 homogeneous pixels. nearest: least w; nothing is known of edges that come nearer. flip: -1 in a mirrored view,
    else 1. Vertices are looked up in a table that is as long as the edges are many, whatever the mesh.
    """
    count = ends.shape[0]
    outwards = np.empty((count, 2))
    for i in range(count):
        _outwards(matrix, nearest, flip, positions, ends[i], outwards[i])
    mask = 4
    while mask < 4 * count:
        mask *= 2
    vertices, rows, met = np.full(mask, -1, np.int32), np.empty((mask, 2), np.int32), np.zeros(mask, np.int32)
    for i in range(count):
        for end in range(2):
            slot = _slot(vertices, ends[i, end])
            if met[slot] < 2:
                rows[slot, met[slot]] = i
            vertices[slot], met[slot] = ends[i, end], met[slot] + 1
    for i in range(count):
        for end in range(2):
            slot = _slot(vertices, ends[i, end])
            other = rows[slot, 0] + rows[slot, 1] - i if met[slot] == 2 else -1
            turns[i, end] = UNKNOWN if other < 0 else _turn(outwards[i], outwards[other], end, flip * ends[i, 3])


@njit(cache=True, nogil=True)
def _slot(vertices, vertex):
    """Where a vertex is in the table, or has room."""
    mask = vertices.shape[0] - 1
    slot = (np.int64(vertex) * 2654435761) & mask
    while vertices[slot] != -1 and vertices[slot] != vertex:
        slot = (slot + 1) & mask
    return slot


@njit(cache=True, nogil=True)
def _outwards(matrix, nearest, flip, positions, row, out):
    """Unit, away from the face; nan where that cannot be said."""
    out[:] = math.nan
    uv = np.empty((2, 2))
    for end in range(2):
        p = positions[row[end]]
        w = matrix[3, 0] * p[0] + matrix[3, 1] * p[1] + matrix[3, 2] * p[2] + matrix[3, 3]
        if w < nearest:
            return
        for k in range(2):
            uv[end, k] = (matrix[k, 0] * p[0] + matrix[k, 1] * p[1] + matrix[k, 2] * p[2] + matrix[k, 3]) / w
    x, y = uv[1, 0] - uv[0, 0], uv[1, 1] - uv[0, 1]
    length = math.sqrt(x * x + y * y)
    if length > 1e-9:
        out[0], out[1] = -flip * row[3] * y / length, flip * row[3] * x / length


@njit(cache=True, nogil=True)
def _turn(own, other, end, facing):
    """From one edge's outward direction to the next one's. end: 1 for the second end of the edge."""
    # outwards is -y, x of the edge's direction when facing is 1
    x, y = facing * own[1], -facing * own[0]
    beyond = (other[0] * x + other[1] * y) * (1.0 if end == 1 else -1.0)
    turn = math.atan2(beyond, other[0] * own[0] + other[1] * own[1])
    return UNKNOWN if math.isnan(turn) else turn
