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
SPREAD = 2654435761
"""Knuth's multiplier: neighbouring vertices have places in the table that are far apart."""


@njit(cache=True, nogil=True)
def turns_at_ends(matrix, nearest, flip, positions, ends, turns):
    """Into turns (n, 2) f8 radians, above 0 where the outline turns outwards: at both ends of the edges in ends (n, 4) i4.

    matrix: (4, 4) f8 homogeneous pixels. nearest: least w; nothing is known of edges that come nearer. flip: -1 in a mirrored view,
    else 1. Vertices are looked up in a table that is as long as the edges are many, whatever the mesh.
    """
    count = ends.shape[0]
    outwards = np.empty((count, 2))
    for i in range(count):
        outwards[i, 0], outwards[i, 1] = _outwards(matrix, nearest, flip * ends[i, 3], positions, ends[i, 0], ends[i, 1])
    mask = np.int64(3)
    while mask < 4 * count:
        mask = 2 * mask + 1
    # a vertex, the rows of its first two edges, and how many it has
    table = np.full((mask + 1, 4), -1, np.int32)
    slots = np.empty((count, 2), np.int64)
    for i in range(count):
        for end in range(2):
            slot = (np.int64(ends[i, end]) * SPREAD) & mask
            while table[slot, 0] != -1 and table[slot, 0] != ends[i, end]:
                slot = (slot + 1) & mask
            if table[slot, 0] == -1:
                table[slot, 0], table[slot, 1], table[slot, 3] = ends[i, end], i, 1
            else:
                table[slot, 2], table[slot, 3] = i, table[slot, 3] + 1
            slots[i, end] = slot
    for i in range(count):
        for end in range(2):
            slot = slots[i, end]
            turns[i, end] = UNKNOWN
            if table[slot, 3] == 2:
                other = table[slot, 1] + table[slot, 2] - i
                x, y = outwards[other, 0], outwards[other, 1]
                turns[i, end] = _turn(outwards[i, 0], outwards[i, 1], x, y, flip * ends[i, 3] * (2 * end - 1))


@njit(cache=True, nogil=True)
def _outwards(matrix, nearest, facing, positions, a, b):
    """Unit, away from the face; nan where that cannot be said."""
    ua, va, wa = _pixel(matrix, positions[a, 0], positions[a, 1], positions[a, 2])
    ub, vb, wb = _pixel(matrix, positions[b, 0], positions[b, 1], positions[b, 2])
    if wa < nearest or wb < nearest:
        return math.nan, math.nan
    x, y = ub / wb - ua / wa, vb / wb - va / wa
    length = math.sqrt(x * x + y * y)
    return (-facing * y / length, facing * x / length) if length > 1e-9 else (math.nan, math.nan)


@njit(cache=True, nogil=True)
def _pixel(m, x, y, z):
    """u, v and w, homogeneous."""
    return (
        m[0, 0] * x + m[0, 1] * y + m[0, 2] * z + m[0, 3],
        m[1, 0] * x + m[1, 1] * y + m[1, 2] * z + m[1, 3],
        m[3, 0] * x + m[3, 1] * y + m[3, 2] * z + m[3, 3],
    )


@njit(cache=True, nogil=True)
def _turn(own_x, own_y, x, y, beyond):
    """From one edge's outward direction to another's. beyond: of its own, turned a quarter, the sign that leads on beyond the end."""
    turn = math.atan2(beyond * (x * own_y - y * own_x), x * own_x + y * own_y)
    return UNKNOWN if math.isnan(turn) else turn
