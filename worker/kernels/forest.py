"""Greedy bottom-up construction of the silhouette forest.

Based on: Silhouette Clipping, section 5 (tree construction): every mesh edge starts as a root; the join (parent, adopt or
merge) with the largest predicted decrease of the extraction cost is applied until none is left.

With P(n | A) = P(n) / P(parent) the cost of a forest telescopes to a sum over nodes,

    cost = k_a roots + sum over nodes P(n) (k_e edges(n) + k_a children(n)),

so a join changes it by the terms of the nodes it touches alone, and all three joins need only P of the united cluster.

Departures. A cluster is remembered by a *summary*: the faces that carry its cones and its most tilted faces in eight
directions, so that predicting a join costs the same for clusters of any size (the stored cones are made from all faces
afterwards). Predictions are lazy: a join whose roots have changed is predicted again when it comes to the top; joins get
dearer as clusters grow, so its old prediction is nearly always too good. The height is limited, which bounds the work of
the final cones.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from geometry.borrowing import borrowing
from geometry.union_find import find_root
from worker.kernels.cones import ALWAYS_FRONT, EYE_RADIUS, UNRELIABLE, fit_cones, miss_probability

CONE_COST = 4.0 / 3.0  # k_a, of testing a node's cones
EDGE_COST = 1.0  # k_e, of testing an edge; the paper measured k_a / k_e = 4/3
SUMMARY = 16
HIGHEST = 40  # levels of a tree
WORK = 10  # rows of scratch

NONE, PARENT, ADOPT_FIRST, ADOPT_SECOND, MERGE = range(5)

HEAP_SIZE, NODES, NEXT_UID, JOINS = range(4)  # rows of Forest.counters


class Forest(NamedTuple):
    """Arrays of the construction; e edges, l links, n = 2 e nodes. A cluster lives in the slot of one of its edges."""

    normals: np.ndarray  # (f, 3) f8
    offsets: np.ndarray  # (f,) f8
    owner: np.ndarray  # (e,) i4 union-find: edge -> slot
    uid: np.ndarray  # (e,) i4 a new number whenever the slot's cluster changes
    summary: np.ndarray  # (e, SUMMARY) i4 faces
    summary_size: np.ndarray  # (e,) i4
    flags: np.ndarray  # (e,) u1 bits ALWAYS_FRONT, UNRELIABLE
    box: np.ndarray  # (e, 6) f4 low, high
    miss: np.ndarray  # (e,) f4 P
    weight: np.ndarray  # (e,) f4 k_e edges + k_a children
    height: np.ndarray  # (e,) i4
    node: np.ndarray  # (e,) i4 tree node of the slot's root
    first_edge: np.ndarray  # (n,) i4 lists of edges and children by node, -1 ends
    last_edge: np.ndarray
    next_edge: np.ndarray  # (e,) i4
    first_child: np.ndarray
    last_child: np.ndarray
    next_sibling: np.ndarray
    links: np.ndarray  # (l, 2) i4 candidate pairs of edges
    link_uid: np.ndarray  # (l, 2) i4 clusters for which the key was predicted
    key: np.ndarray  # (l,) f4 predicted change of cost
    heap: np.ndarray  # (l,) i4 links
    seen: np.ndarray  # (2^k,) i8 direct-mapped memory of pairs that are in the heap
    counters: np.ndarray  # (4,) i8


@borrowing
def _sift_down(heap, key, size, i):
    item = heap[i]
    k = key[item]
    while True:
        child = 2 * i + 1
        if child >= size:
            break
        if child + 1 < size and key[heap[child + 1]] < key[heap[child]]:
            child += 1
        if key[heap[child]] >= k:
            break
        heap[i] = heap[child]
        i = child
    heap[i] = item


@borrowing
def _ball_of(box, a, b, ball):
    square = 0.0
    for k in range(3):
        low, high = min(box[a, k], box[b, k]), max(box[a, k + 3], box[b, k + 3])
        ball[k] = 0.5 * (low + high)
        square += (0.5 * (high - low)) ** 2
    ball[3] = math.sqrt(square) + 1e-9


@borrowing
def _fit(forest, index, count, flags, work, support):
    """P of the faces index[:count]; work (WORK, 4) f8: axis, front, back, ball in rows 0 to 3. support as in `fit_cones`."""
    if flags & UNRELIABLE:
        support[:] = -1  # no cones: nothing carries them
        return np.float32(1.0)
    spread = fit_cones(forest.normals, forest.offsets, index, count, work[3], work[0, :3], work[1, :3], work[2, :3], support, work[4:])
    return np.float32(miss_probability(work[0], spread, work[1], work[2], flags & ALWAYS_FRONT == 0, EYE_RADIUS))


@borrowing
def best_join(miss, weight_a, weight_b, miss_a, miss_b, height_a, height_b):
    """(change of cost, join) of the best join of roots a and b whose union has P = miss; heights bound the choice."""
    best, join = -CONE_COST + 2.0 * CONE_COST * miss, PARENT
    if max(height_a, height_b) + 1 > HIGHEST:
        best, join = 1.0, NONE
    change = -CONE_COST + (miss - miss_a) * weight_a + miss * CONE_COST
    if change < best and height_b + 1 <= HIGHEST:
        best, join = change, ADOPT_FIRST
    change = -CONE_COST + (miss - miss_b) * weight_b + miss * CONE_COST
    if change < best and height_a + 1 <= HIGHEST:
        best, join = change, ADOPT_SECOND
    change = -CONE_COST + (miss - miss_a) * weight_a + (miss - miss_b) * weight_b
    if change < best:
        best, join = change, MERGE
    return best, join


@borrowing
def _unite(forest, a, b, index):
    """Distinct summary faces of both slots into index; returns their number."""
    count = forest.summary_size[a]
    for i in range(count):
        index[i] = forest.summary[a, i]
    own = count
    for j in range(forest.summary_size[b]):
        f = forest.summary[b, j]
        new = True
        for i in range(own):
            if index[i] == f:
                new = False
                break
        if new:
            index[count] = f
            count += 1
    return count


@borrowing
def _predict(forest, a, b, index, work, support):
    count = _unite(forest, a, b, index)
    _ball_of(forest.box, a, b, work[3])
    miss = _fit(forest, index, count, forest.flags[a] | forest.flags[b], work, support)
    miss = max(miss, forest.miss[a], forest.miss[b])
    best, join = best_join(miss, forest.weight[a], forest.weight[b], forest.miss[a], forest.miss[b], forest.height[a], forest.height[b])
    return best, join, miss, count


@njit(cache=True)
def start(forest, edge_faces, kinds, positions, faces):
    """Put every edge into its own root."""
    work, support = np.zeros((WORK, 4)), np.empty(9, np.int32)
    for e in range(edge_faces.shape[0]):
        forest.owner[e], forest.uid[e], forest.node[e], forest.height[e] = e, e, e, 1
        forest.first_edge[e], forest.last_edge[e], forest.next_edge[e] = e, e, -1
        forest.weight[e] = EDGE_COST
        forest.box[e, :3], forest.box[e, 3:] = np.inf, -np.inf
        size, flags = 0, 0
        for s in range(2):
            f = edge_faces[e, s]
            flags |= kinds[f]
            if kinds[f] == 0:
                forest.summary[e, size] = f
                size += 1
            for c in range(3):
                for k in range(3):
                    x = positions[faces[f, c], k]
                    forest.box[e, k] = min(forest.box[e, k], x)
                    forest.box[e, k + 3] = max(forest.box[e, k + 3], x)
        forest.summary_size[e], forest.flags[e] = size, flags
        _ball_of(forest.box, e, e, work[3])
        forest.miss[e] = _fit(forest, forest.summary[e], size, flags, work, support)
    forest.counters[NODES] = forest.counters[NEXT_UID] = edge_faces.shape[0]
    forest.counters[HEAP_SIZE] = 0


@njit(cache=True)
def predict_links(forest, begin, end):
    """Predict links [begin, end) of the initial forest and append the useful ones to the (not yet ordered) heap."""
    index, work, support = np.empty(2 * SUMMARY, np.int32), np.zeros((WORK, 4)), np.empty(9, np.int32)
    size = forest.counters[HEAP_SIZE]
    for i in range(begin, end):
        a, b = forest.links[i, 0], forest.links[i, 1]
        best, join, _, _ = _predict(forest, a, b, index, work, support)
        if join != NONE and best < 0.0:
            forest.key[i] = best
            forest.link_uid[i, 0], forest.link_uid[i, 1] = forest.uid[a], forest.uid[b]
            forest.heap[size] = i
            size += 1
    forest.counters[HEAP_SIZE] = size


@njit(cache=True)
def order_heap(forest):
    """Make the heap a heap."""
    size = forest.counters[HEAP_SIZE]
    for i in range(size // 2 - 1, -1, -1):
        _sift_down(forest.heap, forest.key, size, i)


@borrowing
def _summarise(forest, slot, index, count, axis, support):
    """Keep the faces that carry the cones and the most tilted ones in eight directions."""
    if count <= SUMMARY:
        for i in range(count):
            forest.summary[slot, i] = index[i]
        forest.summary_size[slot] = count
        return
    size = 0
    keep = forest.summary[slot]
    for i in range(9):
        if support[i] >= 0 and not _among(keep, size, support[i]):
            keep[size] = support[i]
            size += 1
    least = 0 if abs(axis[0]) < 0.57 else 1
    tx, ty, tz = -axis[least] * axis[0], -axis[least] * axis[1], -axis[least] * axis[2]
    if least == 0:
        tx += 1.0
    else:
        ty += 1.0
    bx, by, bz = axis[1] * tz - axis[2] * ty, axis[2] * tx - axis[0] * tz, axis[0] * ty - axis[1] * tx
    for k in range(8):
        c, s = math.cos(k * math.pi / 4.0), math.sin(k * math.pi / 4.0)
        dx, dy, dz = c * tx + s * bx, c * ty + s * by, c * tz + s * bz
        best, face = -1e300, -1
        for i in range(count):
            f = index[i]
            tilt = forest.normals[f, 0] * dx + forest.normals[f, 1] * dy + forest.normals[f, 2] * dz
            if tilt > best:
                best, face = tilt, f
        if size < SUMMARY and not _among(keep, size, face):
            keep[size] = face
            size += 1
    forest.summary_size[slot] = size


@borrowing
def _among(list_, size, value):
    for i in range(size):  # noqa: SIM110 - no generators in kernels
        if list_[i] == value:
            return True
    return False


@borrowing
def _append_child(forest, parent, child):
    if forest.first_child[parent] < 0:
        forest.first_child[parent] = child
    else:
        forest.next_sibling[forest.last_child[parent]] = child
    forest.last_child[parent] = child
    forest.next_sibling[child] = -1


@borrowing
def _concatenate(first, last, following, a, b):
    """Append list b to list a."""
    if first[b] < 0:
        return
    if first[a] < 0:
        first[a] = first[b]
    else:
        following[last[a]] = first[b]
    last[a] = last[b]


@borrowing
def _join_nodes(forest, a, b, join):
    """Apply the join to the tree; returns (node, weight, height) of the new root."""
    p, q = forest.node[a], forest.node[b]
    if join == PARENT:
        n = forest.counters[NODES]
        forest.counters[NODES] += 1
        _append_child(forest, n, p)
        _append_child(forest, n, q)
        return n, 2.0 * CONE_COST, max(forest.height[a], forest.height[b]) + 1
    if join == ADOPT_FIRST:
        _append_child(forest, p, q)
        return p, forest.weight[a] + CONE_COST, max(forest.height[a], forest.height[b] + 1)
    if join == ADOPT_SECOND:
        _append_child(forest, q, p)
        return q, forest.weight[b] + CONE_COST, max(forest.height[b], forest.height[a] + 1)
    _concatenate(forest.first_edge, forest.last_edge, forest.next_edge, p, q)
    _concatenate(forest.first_child, forest.last_child, forest.next_sibling, p, q)
    return p, forest.weight[a] + forest.weight[b], max(forest.height[a], forest.height[b])


@borrowing
def _apply(forest, a, b, index, work, support):
    _, join, miss, count = _predict(forest, a, b, index, work, support)
    node, weight, height = _join_nodes(forest, a, b, join)
    if forest.weight[a] < forest.weight[b]:
        a, b = b, a
    forest.owner[b] = a
    forest.node[a], forest.weight[a], forest.height[a], forest.miss[a] = node, weight, height, miss
    forest.flags[a] |= forest.flags[b]
    for k in range(3):
        forest.box[a, k] = min(forest.box[a, k], forest.box[b, k])
        forest.box[a, k + 3] = max(forest.box[a, k + 3], forest.box[b, k + 3])
    _summarise(forest, a, index, count, work[0], support)
    forest.uid[a] = forest.counters[NEXT_UID]
    forest.counters[NEXT_UID] += 1
    forest.counters[JOINS] += 1


@borrowing
def _remember(seen, first, second):
    """Whether this pair was remembered already; remembers it."""
    low, high = min(first, second), max(first, second)
    pair = (np.int64(high) << 32) | np.int64(low)
    place = ((pair * 0x9E3779B97F4A7C1) >> 20) & (seen.shape[0] - 1)
    if seen[place] == pair:
        return True
    seen[place] = pair
    return False


@njit(cache=True)
def grow(forest, rounds):
    """Take up to `rounds` candidates from the heap; returns how many are left."""
    index, work, support = np.empty(2 * SUMMARY, np.int32), np.zeros((WORK, 4)), np.empty(9, np.int32)
    size = forest.counters[HEAP_SIZE]
    for _ in range(rounds):
        if size == 0:
            break
        link = forest.heap[0]
        a, b = find_root(forest.owner, forest.links[link, 0]), find_root(forest.owner, forest.links[link, 1])
        keep = False
        if a != b:
            if forest.uid[a] == forest.link_uid[link, 0] and forest.uid[b] == forest.link_uid[link, 1]:
                _apply(forest, a, b, index, work, support)
            elif not _remember(forest.seen, forest.uid[a], forest.uid[b]):
                best, join, _, _ = _predict(forest, a, b, index, work, support)
                keep = join != NONE and best < 0.0
                forest.key[link] = best
                forest.link_uid[link, 0], forest.link_uid[link, 1] = forest.uid[a], forest.uid[b]
        if not keep:
            size -= 1
            forest.heap[0] = forest.heap[size]
        if size > 0:
            _sift_down(forest.heap, forest.key, size, 0)
    forest.counters[HEAP_SIZE] = size
    return size
