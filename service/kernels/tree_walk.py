"""The walk of a packed silhouette forest: node blocks first, then the leaves they let through.

Based on: Silhouette Clipping, section 5 (runtime algorithm). Departures: eight cones, faces or edges a test; the traversal is
a queue, breadth first, with hardly a branch that depends on the data. A leaf's faces are tested once each, whatever the
number of their edges: by float32 planes with an error bound, and by `geometry.predicates` where that is not sure.

Why a culled node hides nothing: the stored float32 cones are sound as exact cones (`worker.kernels.cones`), and all rounding
of the test here, of the eye included, stays below CONE_ERROR (|p| + |anchor|) |scaled normal|.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from geometry.predicates import is_front_facing
from service.kernels.tree_walk_lanes import (
    BIT_COUNT,
    END_FLOATS,
    FACE_ROWS,
    LANES,
    NODE_ROWS,
    SET_BITS,
    append_lanes,
    edge_sides,
    face_sides,
    missed_cones,
)

CONE_ERROR = 2.0**-19
"""32 u, of which the test's roundings use at most 20."""
AT, FACE_LANE, EDGE_LANE, FACE_BLOCKS, EDGE_BLOCKS, EDGES, MORE = range(7)
LEAF_COLUMNS = 8  # half a cache line
"""Columns of a leaf record: first float, first face lane, first edge lane, blocks of each, edges, whether the next leaf is
of the same node."""
_BYTE = np.uint64(0xFF)
_BITS = SET_BITS.ravel()


@njit(cache=True, nogil=True)
def visit_nodes(nodes, below, parents, guards, next_block, used, eye, w_back, margin, queue, leaf_queue):
    """Fill leaf_queue with twice the lanes whose cone was missed and that have edges; returns (their number, cones tested).

    nodes (b * NODE_ROWS * LANES,) f4; below (b * LANES,) i4; parents, guards (b,) u1: bits of the lanes that have a block
    below, or edges; next_block, used (b,) i4; eye (4,) f4. queue and leaf_queue (b * LANES,) i4 are scratch and keep LANES
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
            mask = np.intp(missed & np.uint64(parents[block]))
            append_lanes(queue, tail, _BITS, mask, base)
            tail += np.intp(BIT_COUNT[mask])
            mask = np.intp(missed & np.uint64(guards[block]))
            append_lanes(leaf_queue, found, _BITS, mask, base)
            found += np.intp(BIT_COUNT[mask])
            block = np.intp(next_block[block])
        if head == tail:
            return found, tested
        block = np.intp(below[queue[head] >> 1])
        head += 1


@njit(cache=True)
def _settle(front, doubtful, lane, lane_face, positions, faces, eye):
    """Decide the doubtful faces of a leaf exactly; returns its front word complete."""
    k = 0
    while doubtful:
        if doubtful & np.uint64(1) and is_front_facing(positions, faces, lane_face[lane + k], eye):
            front |= np.uint64(1) << np.uint64(k)
        doubtful >>= np.uint64(1)
        k += 1
    return front


@njit(cache=True, nogil=True)
def visit_leaves(leaves, record, first_leaf, lane_face, positions, faces, eye, eye4, bound, leaf_queue, found, chosen, turned):
    """Fill chosen with twice the edge lanes on the silhouette; returns (their number, edges tested).

    leaf_queue[:found] as `visit_nodes` left it; first_leaf (b * LANES,) i4. leaves (k,) f4: face blocks, then edge blocks of
    every leaf; record (l, LEAF_COLUMNS) i4; lane_face i4; eye (4,) f8 exact, eye4 (4,) f4 for the planes. chosen i4 keeps
    LANES spare entries. turned (edge blocks,) u1 receives, for the blocks visited, the edges whose right face is front.
    """
    x, y, z, w = eye4[0], eye4[1], eye4[2], eye4[3]
    count, tested = 0, 0
    for i in range(found):
        leaf = np.intp(first_leaf[leaf_queue[i] >> 1])
        while leaf >= 0:
            at, lane = np.intp(record[leaf, AT]), record[leaf, EDGE_LANE]
            front, doubtful = np.uint64(0), np.uint64(0)
            for k in range(record[leaf, FACE_BLOCKS]):
                word = face_sides(leaves, at, x, y, z, w, bound)
                front |= (word & _BYTE) << np.uint64(LANES * k)
                doubtful |= (word >> np.uint64(LANES)) << np.uint64(LANES * k)
                at += FACE_ROWS * LANES
            if doubtful:
                front = _settle(front, doubtful, record[leaf, FACE_LANE], lane_face, positions, faces, eye)
            for _ in range(record[leaf, EDGE_BLOCKS]):
                word = edge_sides(leaves, at, front)
                right = word >> np.uint64(LANES)
                turned[np.uint32(lane) >> np.uint32(3)] = np.uint8(right)
                mask = np.intp((word ^ right) & _BYTE)
                append_lanes(chosen, count, _BITS, mask, np.int32(2 * lane))
                count += np.intp(BIT_COUNT[mask])
                at += END_FLOATS
                lane += np.int32(LANES)
            tested += record[leaf, EDGES]
            leaf = leaf + 1 if record[leaf, MORE] else -1
    return count, tested


@njit(cache=True, nogil=True)
def collect(chosen, count, turned, lane_vertices):
    """(count, 2) i4 directed edges, front-facing side on the left; lane_vertices (lanes, 2) i4."""
    out = np.empty((count, 2), np.int32)
    for k in range(count):
        lane = np.uint32(chosen[k]) >> np.uint32(1)
        start = (np.uint32(turned[lane >> np.uint32(3)]) >> (lane & np.uint32(7))) & np.uint32(1)
        out[k, 0], out[k, 1] = lane_vertices[lane, start], lane_vertices[lane, np.uint32(1) - start]
    return out
