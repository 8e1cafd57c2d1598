"""Directed edges to closed loops, in linear time, on a hash table of the vertices that occur."""

from __future__ import annotations

import numpy as np
from numba import njit

GOLDEN = np.uint64(11400714819323198485)  # 2^64 / golden ratio: spreads neighbouring vertex numbers over the table
FREE = -1


@njit(cache=True, nogil=True)
def _slot(table, keys, vertex, shift):
    """Slot of `vertex`, or the free slot where it belongs."""
    mask = table.shape[0] - 1
    slot = np.int64((np.uint64(vertex) * GOLDEN) >> shift)
    while table[slot] != FREE and keys[table[slot]] != vertex:
        slot = (slot + 1) & mask
    return slot


@njit(cache=True, nogil=True)
def compact(edges):
    """(local (s, 2) i4, vertices (k,) i4): edges by the numbers of their vertices in order of first appearance."""
    count = edges.shape[0]
    bits = 3
    while (1 << bits) < 4 * count:
        bits += 1
    shift = np.uint64(64 - bits)
    table = np.full(1 << bits, FREE, np.int32)
    vertices = np.empty(2 * count, np.int32)
    local = np.empty((count, 2), np.int32)
    known = 0
    for e in range(count):
        for side in range(2):
            vertex = edges[e, side]
            slot = _slot(table, vertices, vertex, shift)
            if table[slot] == FREE:
                table[slot] = known
                vertices[known] = vertex
                known += 1
            local[e, side] = table[slot]
    return local, vertices[:known]


@njit(cache=True, nogil=True)
def _outgoing(local, vertex_count):
    """(first (k,) i4, following (s,) i4, unbalanced): the edges that leave each vertex, as linked lists."""
    first = np.full(vertex_count, FREE, np.int32)
    following = np.empty(local.shape[0], np.int32)
    balance = np.zeros(vertex_count, np.int32)
    for e in range(local.shape[0] - 1, -1, -1):
        source = local[e, 0]
        following[e] = first[source]
        first[source] = e
        balance[source] += 1
        balance[local[e, 1]] -= 1
    return first, following, bool(np.any(balance))


@njit(cache=True, nogil=True)
def simple_loops(edges):
    """(vertices (s,) i4, offsets (c + 1,) i4, balanced): the edges as closed loops that visit no vertex twice.

    A walk follows unused edges; whenever it returns to a vertex of its own path, that loop is cut off the path. With equal
    numbers of edges in and out everywhere, a walk can only end where it began, so nothing is left over.
    """
    local, vertices = compact(edges)
    first, following, unbalanced = _outgoing(local, vertices.shape[0])
    out = np.empty(edges.shape[0], np.int32)
    offsets = np.zeros(edges.shape[0] + 1, np.int32)
    if unbalanced:
        return out[:0], offsets[:1], False
    path = np.empty(edges.shape[0] + 1, np.int32)
    place = np.full(vertices.shape[0], FREE, np.int32)
    used, loops = 0, 0
    for start in range(vertices.shape[0]):
        length = 1
        path[0] = start
        place[start] = 0
        while True:
            here = path[length - 1]
            edge = first[here]
            if edge == FREE:
                break
            first[here] = following[edge]
            there = local[edge, 1]
            if place[there] == FREE:
                place[there] = length
                path[length] = there
                length += 1
                continue
            begin = place[there]
            for i in range(begin, length):
                out[used] = vertices[path[i]]
                used += 1
                place[path[i]] = FREE
            loops += 1
            offsets[loops] = used
            place[there] = begin
            length = begin + 1
        place[start] = FREE
    return out, offsets[: loops + 1], True
