"""Packs a preorder silhouette forest into blocks of eight for the walk.

A *node block* holds up to eight cones tested together; each has the leaves it guards and the node block below it, or -1.
Roots, and children beyond eight, run on in the `next` block. A block is filled up with grandchildren where there is room:
the child most likely to be walked for the lanes it takes gives its place to its own children; its edges keep its cone.

Blocks and leaves are numbered breadth first, in the order of the walk, so that what is visited together lies together.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from service.kernels.tree_walk import BELOW, BLOCK_WORDS, LEAF, MASKS, NEXT
from service.kernels.tree_walk_lanes import LANES

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
def pack_nodes(item, below, next_block, lines, scaled_normal, front_anchor, back_anchor, separation, arena):
    """Node blocks into the head of arena (b * BLOCK_WORDS words, zero) from items, blocks below and first leaves' lines
    (b, LANES) i4, and next blocks (b,) i4, as the walk reads them; an item without cones, or none, is never in a cone."""
    floats = arena.view(np.float32)
    for b in range(item.shape[0]):
        at = b * BLOCK_WORDS
        arena[at + NEXT] = next_block[b] * BLOCK_WORDS if next_block[b] >= 0 else -1
        for j in range(LANES):
            floats[at + 11 * LANES + j] = 1.0  # with a zero normal, the margin alone then fails both tests
            arena[at + BELOW + j] = below[b, j] * BLOCK_WORDS if below[b, j] >= 0 else -1
            arena[at + LEAF + j] = lines[b, j]
            if item[b, j] < 0:
                continue
            node = item[b, j] & ~EDGES_ONLY
            arena[at + MASKS] += 1 << 16
            arena[at + MASKS] |= (1 << j if below[b, j] >= 0 else 0) | (256 << j if lines[b, j] >= 0 else 0)
            square, along = 0.0, 0.0
            for k in range(3):
                s = np.float64(scaled_normal[node, k])
                square += s * s
                along += s * np.float64(front_anchor[node, k])
                floats[at + k * LANES + j] = scaled_normal[node, k]
                floats[at + (3 + k) * LANES + j] = front_anchor[node, k]
                floats[at + (6 + k) * LANES + j] = back_anchor[node, k]
            if square > 0.0:
                floats[at + 9 * LANES + j] = along
                floats[at + 10 * LANES + j] = separation[node]
                floats[at + 11 * LANES + j] = math.sqrt(square) * (1.0 + 1e-6)
