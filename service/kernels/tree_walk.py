"""The walk of a packed silhouette forest: node blocks first, then the leaves they let through.

Based on: Silhouette Clipping, section 5 (runtime algorithm). Departures: eight cones, faces or edges a test; the traversal is
a queue, breadth first, with hardly a branch that depends on the data. A leaf's faces are tested once each, whatever the
number of their edges: by float32 planes with an error bound, and by `geometry.predicates` where that is not sure.

Why a culled node hides nothing: the stored float32 cones are sound as exact cones (`worker.kernels.cones`), and all rounding
of the test here, of the eye included, stays below CONE_ERROR (|p| + |anchor|) |scaled normal|.
"""

from __future__ import annotations

from typing import NamedTuple

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
    prefetch,
)

CONE_ERROR = 2.0**-19
"""32 u, of which the test's roundings use at most 20."""
AT, FACE_LANE, EDGE_LANE, FACE_BLOCKS, EDGE_BLOCKS, EDGES, MORE = range(7)
LEAF_COLUMNS = 8  # half a cache line
"""Columns of a leaf record: first float, first face lane, first edge lane, blocks of each, edges, whether the next leaf is
of the same node."""
LINE = 16  # floats in a cache line
_BYTE = np.uint64(0xFF)
_BITS = SET_BITS.ravel()


class Packed(NamedTuple):
    """A forest packed for the walk: b node blocks, l leaves, LANES lanes a block."""

    nodes: np.ndarray  # (b * NODE_ROWS * LANES,) f4
    below: np.ndarray  # (b * LANES,) i4 node block with the children, -1: none
    parents: np.ndarray  # (b,) u1 bits of the lanes that have a block below
    guards: np.ndarray  # (b,) u1 bits of the lanes that have edges
    next_block: np.ndarray  # (b,) i4 where the siblings run on, -1: nowhere
    used: np.ndarray  # (b,) i4 lanes in use
    first_leaf: np.ndarray  # (b * LANES,) i4, -1: no edges
    leaves: np.ndarray  # f4 face blocks, then edge blocks, of every leaf
    record: np.ndarray  # (l, LEAF_COLUMNS) i4
    lane_face: np.ndarray  # (face lanes,) i4
    lane_vertices: np.ndarray  # (edge lanes, 2) i4


class Queues(NamedTuple):
    """Scratch of one walk at a time."""

    nodes: np.ndarray  # (b * LANES + LANES,) i4
    leaves: np.ndarray  # (b * LANES + LANES,) i4
    chosen: np.ndarray  # (edge lanes + LANES,) i4
    turned: np.ndarray  # (edge blocks,) u1


@njit(cache=True, nogil=True)
def visit_nodes(packed, queues, x, y, z, w, w_back, margin):
    """Fill queues.leaves with twice the lanes whose cone was missed and that have edges; returns (their number, cones tested).

    (x, y, z, w) f4 the eye; w_back and margin as in `missed_cones`.
    """
    nodes, below, parents, guards, next_block, used = (
        packed.nodes, packed.below, packed.parents, packed.guards, packed.next_block, packed.used,
    )  # fmt: skip
    queue, leaf_queue = queues.nodes, queues.leaves
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
def visit_leaves(packed, queues, found, positions, faces, eye, x, y, z, w, bound):
    """Fill queues.chosen with twice the edge lanes on the silhouette; returns (their number, edges tested).

    queues.leaves[:found] as `visit_nodes` left it. eye (4,) f8 exact, (x, y, z, w) f4 for the planes, bound: of their error.
    queues.turned receives, for the edge blocks visited, the edges whose right face is front.
    """
    leaves, record, first_leaf, lane_face = packed.leaves, packed.record, packed.first_leaf, packed.lane_face
    leaf_queue, chosen, turned = queues.leaves, queues.chosen, queues.turned
    count, tested = 0, 0
    for i in range(found):
        leaf = np.intp(first_leaf[leaf_queue[i] >> 1])
        coming = np.intp(record[first_leaf[leaf_queue[min(i + 2, found - 1)] >> 1], AT])
        while leaf >= 0:
            at, lane = np.intp(record[leaf, AT]), record[leaf, EDGE_LANE]
            front, doubtful = np.uint64(0), np.uint64(0)
            for k in range(record[leaf, FACE_BLOCKS]):
                word = face_sides(leaves, at, x, y, z, w, bound)
                front |= (word & _BYTE) << np.uint64(LANES * k)
                doubtful |= (word >> np.uint64(LANES)) << np.uint64(LANES * k)
                prefetch(leaves, coming)
                prefetch(leaves, coming + LINE)
                at += FACE_ROWS * LANES
                coming += FACE_ROWS * LANES
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


@njit(cache=True, nogil=True)
def walk(
    nodes, below, parents, guards, next_block, used, first_leaf, leaves, record, lane_face, lane_vertices,
    node_queue, leaf_queue, chosen, turned, positions, faces, eye, x, y, z, w_back, margin, bound,
):  # fmt: skip
    """(edges (s, 2) i4, edges tested, cones tested) for the exact eye (4,) f8; (x, y, z): the eye for float32.

    The arrays are those of Packed and Queues, one by one: handing tuples of arrays to compiled code costs microseconds.
    """
    packed = Packed(nodes, below, parents, guards, next_block, used, first_leaf, leaves, record, lane_face, lane_vertices)
    queues = Queues(node_queue, leaf_queue, chosen, turned)
    x, y, z, w = np.float32(x), np.float32(y), np.float32(z), np.float32(eye[3])
    found, cones = visit_nodes(packed, queues, x, y, z, w, np.float32(w_back), np.float32(margin))
    count, edges = visit_leaves(packed, queues, found, positions, faces, eye, x, y, z, w, np.float32(bound))
    return collect(chosen, count, turned, lane_vertices), edges, cones
