"""The walk of a packed silhouette forest: node blocks first, then the edge blocks they let through.

Based on: Silhouette Clipping, section 5 (runtime algorithm). Departures: eight cones and eight edges a test; the traversal is
a queue, breadth first, with no branch that depends on the data: a missed cone adds what it guards, a hit one adds nothing.
Facing is decided by float32 planes with an error bound, and by `geometry.predicates` where they are not sure.

Why a culled node hides nothing: the stored float32 cones are sound as exact cones (`worker.kernels.cones`), and all rounding
of the test here, of the eye included, stays below CONE_ERROR (|p| + |anchor|) |scaled normal|.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from geometry.predicates import is_front_facing
from service.kernels.tree_walk_lanes import BIT_COUNT, EDGE_ROWS, LANES, NODE_ROWS, SET_BITS, append_lanes, edge_sides, missed_cones

CONE_ERROR = 2.0**-19
"""32 u, of which the test's roundings use at most 20."""
_ALL = np.uint32(0xFF)
_BITS = SET_BITS.ravel()


@njit(cache=True, nogil=True)
def visit_nodes(nodes, below, guarded, parents, guards, next_block, used, eye, w_back, margin, queue, edge_queue):
    """Fill edge_queue with twice the lanes whose cone was missed and that guard edges; returns (their number, cones tested).

    nodes (b * NODE_ROWS * LANES,) f4; below (b * LANES,) i4; parents, guards (b,) u1: bits of the lanes that have a block
    below, or edges; next_block, used (b,) i4; eye (4,) f4. queue and edge_queue (b * LANES,) i4 are scratch and keep LANES
    spare entries.
    """
    x, y, z, w = eye[0], eye[1], eye[2], eye[3]
    head, tail, found, tested = 0, 0, 0, 0
    block = np.intp(0)
    while True:
        while block >= 0:
            tested += used[block]
            missed = missed_cones(nodes, block * (NODE_ROWS * LANES), x, y, z, w, w_back, margin)
            base = np.int32(block * (2 * LANES))
            mask = np.intp(missed & np.uint32(parents[block]))
            append_lanes(queue, tail, _BITS, mask, base)
            tail += np.intp(BIT_COUNT[mask])
            mask = np.intp(missed & np.uint32(guards[block]))
            append_lanes(edge_queue, found, _BITS, mask, base)
            found += np.intp(BIT_COUNT[mask])
            block = np.intp(next_block[block])
        if head == tail:
            return found, tested
        block = np.intp(below[queue[head] >> 1])
        head += 1


@njit(cache=True)
def _settle(word, block, lane_edge, positions, faces, edge_faces, eye):
    """Decide the doubtful faces of an edge block exactly; returns bytes 0 and 1 of the word."""
    for j in range(LANES):
        e = lane_edge[block * LANES + j]
        for side in range(2):
            if (word >> np.uint32(16 + 8 * side + j)) & np.uint32(1):
                # an unused lane has the left plane of lane 0 on both sides: equal sides, never on the silhouette
                f = edge_faces[e, side] if e >= 0 else edge_faces[lane_edge[block * LANES], 0]
                if is_front_facing(positions, faces, f, eye):
                    word |= np.uint32(1) << np.uint32(8 * side + j)
    return word


@njit(cache=True, nogil=True)
def visit_edges(planes, guarded, more, used, lane_edge, positions, faces, edge_faces, eye, eye4, bound, edge_queue, found, chosen):
    """Fill chosen with 2 lane + (0: left face front, 1: right face front); returns (their number, edges tested).

    edge_queue[:found] as `visit_nodes` left it; guarded (b * LANES,) i4. planes (c * EDGE_ROWS * LANES,) f4; more, used (c,) i4; lane_edge (c * LANES,) i4; eye (4,) f8 exact, eye4 (4,) f4 for the
    planes. chosen i4 keeps LANES spare entries.
    """
    x, y, z, w = eye4[0], eye4[1], eye4[2], eye4[3]
    count, tested = 0, 0
    for i in range(found):
        block = np.intp(guarded[edge_queue[i] >> 1])
        while block >= 0:
            tested += used[block]
            word = edge_sides(planes, block * (EDGE_ROWS * LANES), x, y, z, w, bound)
            if word >> np.uint32(16):
                word = _settle(word, block, lane_edge, positions, faces, edge_faces, eye)
            left, right = np.intp(word & _ALL), np.intp((word >> np.uint32(8)) & _ALL)
            base = np.int32(block * (2 * LANES))
            append_lanes(chosen, count, _BITS, left & ~right, base)
            count += np.intp(BIT_COUNT[left & ~right])
            append_lanes(chosen, count, _BITS, right & ~left, base + np.int32(1))
            count += np.intp(BIT_COUNT[right & ~left])
            block = block + 1 if more[block] else -1
    return count, tested


@njit(cache=True, nogil=True)
def collect(chosen, count, lane_vertices):
    """(count, 2) i4 directed edges."""
    out = np.empty((count, 2), np.int32)
    for k in range(count):
        lane, start = np.uint32(chosen[k]) >> np.uint32(1), np.uint32(chosen[k]) & np.uint32(1)
        out[k, 0], out[k, 1] = lane_vertices[lane, start], lane_vertices[lane, np.uint32(1) - start]
    return out
