"""Packs a preorder silhouette forest into blocks of eight for the walk.

A *node block* holds up to eight cones tested together; each has the leaves it guards and the node block below it, or -1.
A *leaf* holds the planes of up to LEAF_FACES faces, eight to a block, and edges that name their faces by their number in it.
Roots, and children beyond eight, run on in the `next` block. A block is filled up with grandchildren where there is room:
the child most likely to be walked for the lanes it takes gives its place to its own children; its edges keep its cone.

Blocks and leaves are numbered breadth first, in the order of the walk, so that what is visited together lies together.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from service.kernels.tree_walk import AT, EDGE_BLOCKS, EDGE_LANE, EDGES, FACE_BLOCKS, FACE_LANE, MORE
from service.kernels.tree_walk_lanes import END_FLOATS, FACE_ROWS, LANES, LEAF_FACES

EDGES_ONLY = 1 << 30
"""Added to a node's number in an item: its edges alone, its children are items of the same block."""


@njit(cache=True)
def _children(skip, node, items, size):
    """Append the children of a node to items; returns the new size."""
    child = node + 1
    while child < skip[node]:
        items[size] = child
        size += 1
        child = skip[child]
    return size


@njit(cache=True)
def _child_count(skip, node):
    count, child = 0, node + 1
    while child < skip[node]:
        count += 1
        child = skip[child]
    return count


@njit(cache=True)
def _fill_up(skip, edge_start, scaled_normal, items, size):
    """Replace items by their children while all fit into one block; returns the new size."""
    while True:
        chosen, best = -1, -1.0
        for i in range(size):
            node = items[i]
            if node & EDGES_ONLY or skip[node] == node + 1:
                continue
            own = 1 if edge_start[node + 1] > edge_start[node] else 0
            more = own + _child_count(skip, node) - 1
            if size + more > LANES:
                continue
            square = 0.0
            for k in range(3):
                square += np.float64(scaled_normal[node, k]) ** 2
            miss = 1.0 / math.sqrt(max(1.0, square))
            gain = miss / max(1, more)
            if gain > best:
                chosen, best = i, gain
        if chosen < 0:
            return size
        node = items[chosen]
        if edge_start[node + 1] > edge_start[node]:
            items[chosen] = node | EDGES_ONLY
        else:
            items[chosen] = items[size - 1]
            size -= 1
        size = _children(skip, node, items, size)


@njit(cache=True)
def group(skip, edge_start, scaled_normal, item, below, next_block):
    """Share the nodes out to node blocks; returns the number of blocks.

    item (b, LANES) i4 receives node numbers (EDGES_ONLY added where the children are elsewhere in the block), -1 where
    empty; below (b, LANES) i4 the node block with an item's children, -1 where none; next_block (b,) i4, -1 ends.
    """
    n = skip.shape[0]
    items = np.empty(n + LANES, np.int32)
    waiting = np.empty(n + 1, np.int32)  # nodes whose children have no block yet, with the place that asks for it
    asks = np.empty(n + 1, np.int32)
    head, tail, blocks = 0, 1, 0
    waiting[0], asks[0] = -1, -1
    while head < tail:
        node, place = waiting[head], asks[head]
        head += 1
        size = 0
        if node < 0:
            root = 0
            while root < n:
                items[size] = root
                size += 1
                root = skip[root]
        else:
            size = _children(skip, node, items, 0)
        if size < LANES:
            size = _fill_up(skip, edge_start, scaled_normal, items, size)
        if place >= 0:
            below[place // LANES, place % LANES] = blocks
        for i in range(0, size, LANES):
            next_block[blocks] = blocks + 1 if i + LANES < size else -1
            for j in range(LANES):
                below[blocks, j] = -1
                item[blocks, j] = items[i + j] if i + j < size else -1
                if i + j < size and items[i + j] & EDGES_ONLY == 0 and skip[items[i + j]] > items[i + j] + 1:
                    waiting[tail], asks[tail] = items[i + j], blocks * LANES + j
                    tail += 1
            blocks += 1
    return blocks


@njit(cache=True)
def pack_nodes(item, scaled_normal, front_anchor, back_anchor, separation, packed):
    """packed (b, NODE_ROWS, LANES) f4 of items (b, LANES); an item without cones, or none, is never in a cone."""
    for b in range(item.shape[0]):
        for j in range(LANES):
            packed[b, :, j] = 0.0
            packed[b, 11, j] = 1.0  # with a zero normal, the margin alone then fails both tests
            if item[b, j] < 0:
                continue
            node = item[b, j] & ~EDGES_ONLY
            square, along = 0.0, 0.0
            for k in range(3):
                s = np.float64(scaled_normal[node, k])
                square += s * s
                along += s * np.float64(front_anchor[node, k])
                packed[b, k, j] = scaled_normal[node, k]
                packed[b, 3 + k, j] = front_anchor[node, k]
                packed[b, 6 + k, j] = back_anchor[node, k]
            if square > 0.0:
                packed[b, 9, j] = along
                packed[b, 10, j] = separation[node]
                packed[b, 11, j] = math.sqrt(square) * (1.0 + 1e-6)


@njit(cache=True)
def split_leaves(item, edge_start, edge_index, edge_faces, mark, first_leaf, leaf_start, more):
    """Share the edges of every item out to leaves of at most LEAF_FACES faces; returns their number.

    first_leaf (b, LANES) i4: -1 where an item has no edges; leaf_start (e + 1,) i4 into edge_index, in the order of the
    leaves, which is that of the returned permutation; more (e,) i4; mark (f,) i4 scratch, -1 at first.
    """
    order = np.empty_like(edge_index)
    leaf, at = 0, 0
    for b in range(item.shape[0]):
        for j in range(LANES):
            first_leaf[b, j] = -1
            if item[b, j] < 0:
                continue
            node = item[b, j] & ~EDGES_ONLY
            if edge_start[node] == edge_start[node + 1]:
                continue
            first_leaf[b, j] = leaf
            leaf_start[leaf] = at
            known = 0
            for k in range(edge_start[node], edge_start[node + 1]):
                f, g = edge_faces[edge_index[k], 0], edge_faces[edge_index[k], 1]
                new = (1 if mark[f] != leaf else 0) + (1 if mark[g] != leaf else 0)
                if known + new > LEAF_FACES:
                    more[leaf] = 1
                    leaf += 1
                    leaf_start[leaf] = at
                    known, new = 0, 2
                known += new
                mark[f], mark[g] = leaf, leaf
                order[at] = edge_index[k]
                at += 1
            more[leaf] = 0
            leaf += 1
    leaf_start[leaf] = at
    return leaf, order


@njit(cache=True)
def measure_leaves(leaf_start, more, order, edge_faces, mark, record):
    """Fill record (l, LEAF_COLUMNS) i4; returns (floats, face lanes, edge lanes). mark (f,) i4 scratch, -1 at first."""
    at, face_lane, edge_lane = 0, 0, 0
    for leaf in range(record.shape[0]):
        known = 0
        for k in range(leaf_start[leaf], leaf_start[leaf + 1]):
            for side in range(2):
                f = edge_faces[order[k], side]
                if mark[f] != leaf:
                    mark[f] = leaf
                    known += 1
        edges = leaf_start[leaf + 1] - leaf_start[leaf]
        face_blocks, edge_blocks = (known + LANES - 1) // LANES, (edges + LANES - 1) // LANES
        record[leaf, AT], record[leaf, FACE_LANE], record[leaf, EDGE_LANE] = at, face_lane, edge_lane
        record[leaf, FACE_BLOCKS], record[leaf, EDGE_BLOCKS] = face_blocks, edge_blocks
        record[leaf, EDGES], record[leaf, MORE] = edges, more[leaf]
        at += face_blocks * FACE_ROWS * LANES + edge_blocks * END_FLOATS
        face_lane += face_blocks * LANES
        edge_lane += edge_blocks * LANES
    return at, face_lane, edge_lane


@njit(cache=True)
def pack_leaves(record, leaf_start, order, edge_vertices, edge_faces, x, y, z, d, mark, leaves, lane_face, lane_vertices):
    """Planes and face numbers of all leaves into leaves (k,) f4; an unused face lane repeats the first, an unused edge lane
    has that face on both sides, so neither shows. lane_face (face lanes,), lane_vertices (edge lanes, 2) i4.

    mark (f,) i4 scratch, any content.
    """
    ends = leaves.view(np.uint8)
    lane_vertices[:, :] = -1
    for leaf in range(record.shape[0]):
        base, known = record[leaf, FACE_LANE], 0
        first_end = 4 * (record[leaf, AT] + record[leaf, FACE_BLOCKS] * FACE_ROWS * LANES)
        ends[first_end : first_end + 4 * END_FLOATS * record[leaf, EDGE_BLOCKS]] = 0
        for k in range(leaf_start[leaf], leaf_start[leaf + 1]):
            e, lane = order[k], k - leaf_start[leaf]
            for side in range(2):
                f = edge_faces[e, side]
                m = mark[f]
                if not (0 <= m < known and lane_face[base + m] == f):
                    m = known
                    mark[f] = m
                    lane_face[base + m] = f
                    known += 1
                ends[first_end + lane // LANES * (2 * LANES) + side * LANES + lane % LANES] = m
                lane_vertices[record[leaf, EDGE_LANE] + lane, side] = edge_vertices[e, side]
        for m in range(record[leaf, FACE_BLOCKS] * LANES):
            if m >= known:
                lane_face[base + m] = lane_face[base]
            f = lane_face[base + m]
            at = record[leaf, AT] + m // LANES * (FACE_ROWS * LANES) + m % LANES
            leaves[at], leaves[at + LANES], leaves[at + 2 * LANES], leaves[at + 3 * LANES] = x[f], y[f], z[f], d[f]
