"""Makes a preorder forest coarser where eight edges are tested in the time of one.

The stored forest is optimal for the paper's costs, a cone against an edge 4 to 3. With blocks of eight the edges of a small
node cost next to nothing, while visiting it costs a cache miss and an unpredictable branch; so a node hands its edges and
children to its parent where that is predicted to be faster. Cones stay as they are: a parent's hold for all below.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from service.kernels.tree_walk_leaf import ALL

CONE_COST, LEAF_COST, EDGE_COST = 6.0, 40.0, 0.5
"""Nanoseconds that a cone takes, a leaf, and an edge in it."""
EYE_DISTANCE = 2.5
"""Normalised units; the nearer the eye, the more a node's thickness counts beside its spread."""


@njit(cache=True)
def _cost(edges):
    """Of testing the edges of a node that has some, in as many leaves as they need."""
    return max(1.0, edges / ALL) * LEAF_COST + edges * EDGE_COST


@njit(cache=True)
def is_nested(skip):
    """Whether every subtree ends inside the one around it."""
    ends = np.empty(skip.shape[0] + 1, np.int64)
    depth = 0
    for i in range(skip.shape[0]):
        while depth > 0 and ends[depth - 1] <= i:
            depth -= 1
        if depth > 0 and skip[i] > ends[depth - 1]:
            return False
        ends[depth] = skip[i]
        depth += 1
    return True


@njit(cache=True)
def parents_of(skip):
    """(n,) i4 parent of every node, -1 for roots."""
    parent = np.full(skip.shape[0], -1, np.int32)
    for i in range(skip.shape[0]):
        child = i + 1
        while child < skip[i]:
            parent[child] = i
            child = skip[child]
    return parent


@njit(cache=True)
def miss_probability(scaled_normal, separation):
    """(n,) f8: how likely an eye is in neither cone of a node: 1 / |scaled normal| for far eyes, and more by its thickness."""
    miss = np.ones(separation.shape[0])
    for i in range(separation.shape[0]):
        square = 0.0
        for k in range(3):
            square += np.float64(scaled_normal[i, k]) ** 2
        if square > 1.0:
            length = math.sqrt(square)
            if separation[i] > 1e38:
                miss[i] = 0.5 + 0.5 / length
            else:
                miss[i] = min(1.0, 1.0 / length + separation[i] / length / (2.0 * EYE_DISTANCE))
    return miss


@njit(cache=True)
def _gain(p, child, total, edges, children, miss):
    """Change of the cost when node p, with `total` edges by then, takes the edges and children of a child."""
    change = (miss[p] - miss[child]) * CONE_COST * children[child] - miss[p] * CONE_COST
    if edges[child] > 0:
        change += miss[p] * (_cost(total + edges[child]) - _cost(total)) - miss[child] * _cost(edges[child])
    return change


@njit(cache=True)
def worth_their_test(edge_start, miss, parent):
    """(n,) bool: nodes to keep; miss (n,) f8 of `miss_probability`.

    From the leaves up, a node takes those children whose union with it is predicted to be cheaper, and then theirs.
    """
    n = miss.shape[0]
    edges, children = np.empty(n, np.int64), np.zeros(n, np.int64)
    first, following = np.full(n, -1, np.int32), np.full(n, -1, np.int32)
    keep, taken = np.ones(n, np.bool_), np.empty(n, np.bool_)
    for i in range(n - 1, -1, -1):
        edges[i] = edge_start[i + 1] - edge_start[i]
        more = children[i] > 0
        while more:
            total, change = edges[i], 0.0 if edges[i] else miss[i] * LEAF_COST
            child = first[i]
            while child >= 0:
                gain = _gain(i, child, total, edges, children, miss)
                taken[child] = gain < 0.0
                if taken[child]:
                    total, change = total + edges[child], change + gain
                child = following[child]
            more = change < 0.0
            if more:
                more = _take(i, taken, first, following, edges, children, keep)
        if parent[i] >= 0:
            following[i], first[parent[i]] = first[parent[i]], i
            children[parent[i]] += 1
    return keep


@njit(cache=True)
def _take(node, taken, first, following, edges, children, keep):
    """Give the taken children's edges and children to the node; returns whether one was taken."""
    child, some = first[node], False
    first[node] = -1
    while child >= 0:
        after = following[child]
        if taken[child]:
            some = True
            keep[child] = False
            edges[node] += edges[child]
            children[node] += children[child] - 1
            grandchild = first[child]
            while grandchild >= 0:
                next_one = following[grandchild]
                following[grandchild], first[node] = first[node], grandchild
                grandchild = next_one
        else:
            following[child], first[node] = first[node], child
        child = after
    return some


@njit(cache=True)
def without(skip, edge_start, edge_index, parent, keep):
    """(nodes, skip, edge_start, edge_index) of the kept nodes: their old numbers, and the forest they make."""
    n = skip.shape[0]
    owner, number = np.empty(n, np.int32), np.zeros(n + 1, np.int32)
    for i in range(n):
        owner[i] = i if keep[i] else owner[parent[i]]
        number[i + 1] = number[i] + (1 if keep[i] else 0)
    nodes = np.flatnonzero(keep).astype(np.int32)
    start = np.zeros(nodes.shape[0] + 1, np.int32)
    for i in range(n):
        start[number[owner[i]] + 1] += edge_start[i + 1] - edge_start[i]
    for i in range(nodes.shape[0]):
        start[i + 1] += start[i]
    place, index = start[:-1].copy(), np.empty_like(edge_index)
    for i in range(n):
        o = number[owner[i]]
        for k in range(edge_start[i], edge_start[i + 1]):
            index[place[o]] = edge_index[k]
            place[o] += 1
    new_skip = np.empty(nodes.shape[0], np.int32)
    for i in range(nodes.shape[0]):
        new_skip[i] = number[skip[nodes[i]]]
    return nodes, new_skip, start, index
