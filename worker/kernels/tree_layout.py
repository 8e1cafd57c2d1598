"""Linked forest -> preorder arrays, and the final cones of every node from all its faces."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from worker.kernels.cones import ALWAYS_FRONT, EYE_RADIUS, NO_CONE, UNRELIABLE, fit_cones, miss_probability, verified_cones


@njit(cache=True)
def flatten(roots, first_edge, next_edge, first_child, next_sibling, skip, edge_start, edge_index):
    """Preorder of the forest below roots (r,) i4; fills skip (n,), edge_start (n + 1,), edge_index (e,); returns n.

    skip[i] is the number of the first node after the subtree of node i.
    """
    stack = np.empty(skip.shape[0] + 1, np.int32)
    number = np.empty(skip.shape[0] + 1, np.int32)  # >= 0: the node whose subtree ends here
    nodes, edges = 0, 0
    for r in roots:
        stack[0], number[0] = r, -1
        size = 1
        while size > 0:
            size -= 1
            node = stack[size]
            if number[size] >= 0:
                skip[number[size]] = nodes
                continue
            stack[size], number[size] = node, nodes
            size += 1
            edge_start[nodes] = edges
            e = first_edge[node]
            while e >= 0:
                edge_index[edges] = e
                edges += 1
                e = next_edge[e]
            nodes += 1
            low = size
            child = first_child[node]
            while child >= 0:
                stack[size], number[size] = child, -1
                size += 1
                child = next_sibling[child]
            for i in range((size - low) // 2):
                stack[low + i], stack[size - 1 - i] = stack[size - 1 - i], stack[low + i]
    edge_start[nodes] = edges
    return nodes


@njit(cache=True)
def _gather(edges, edge_faces, kinds, mark, node, index):
    """Distinct faces of the edges into index; returns (reliable ones, union of kinds)."""
    count, flags = 0, 0
    for e in edges:
        for s in range(2):
            f = edge_faces[e, s]
            if mark[f] != node:
                mark[f] = node
                flags |= kinds[f]
                if kinds[f] == 0:
                    index[count] = f
                    count += 1
    return count, flags


@njit(cache=True)
def _bounding_ball(index, count, positions, faces, ball):
    low, high = np.full(3, 1e300), np.full(3, -1e300)
    for i in range(count):
        for c in range(3):
            for k in range(3):
                x = np.float64(positions[faces[index[i], c], k])
                low[k], high[k] = min(low[k], x), max(high[k], x)
    square = 0.0
    for k in range(3):
        ball[k] = 0.5 * (low[k] + high[k])
        square += (0.5 * (high[k] - low[k])) ** 2
    ball[3] = math.sqrt(square) + 1e-9


@njit(cache=True)
def cone_nodes(
    begin, end, skip, edge_start, edge_index, edge_faces, positions, faces, normals, offsets, kinds, mark, index,
    scaled, front, back, separation, miss,
):  # fmt: skip
    """Verified cones of nodes [begin, end) from every face of their subtrees, and their P.

    mark (f,) i4 starts at -1; index (f,) i4 is scratch. A node without cones gets zeros everywhere: it is never culled.
    """
    axis, high, low = np.empty(3), np.empty(3), np.empty(3)
    ball, support, scratch = np.empty(4), np.empty(9, np.int32), np.empty((6, 4))
    for node in range(begin, end):
        scaled[node, :], front[node, :], back[node, :], separation[node], miss[node] = 0.0, 0.0, 0.0, 0.0, 1.0
        own = edge_index[edge_start[node] : edge_start[skip[node]]]
        count, flags = _gather(own, edge_faces, kinds, mark, node, index)
        if count == 0 or flags & UNRELIABLE:
            continue
        _bounding_ball(index, count, positions, faces, ball)
        spread = fit_cones(normals, offsets, index, count, ball, axis, high, low, support, scratch)
        if spread <= 0.0:
            continue
        always_front = flags & ALWAYS_FRONT != 0
        d = verified_cones(normals, offsets, index, count, always_front, axis, spread, high, low, scaled[node], front[node], back[node])
        if d < 0.0:
            scaled[node, :], front[node, :], back[node, :] = 0.0, 0.0, 0.0
            continue
        separation[node] = d
        for k in range(3):
            high[k], low[k] = front[node, k], back[node, k]
        miss[node] = miss_probability(axis, spread, high, low, d != NO_CONE, EYE_RADIUS)
