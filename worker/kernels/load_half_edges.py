"""Half-edges of the same undirected edge, found by counting: linear in the faces."""

from __future__ import annotations

import numpy as np
from numba import njit

SHORT = 32
"""Length up to which a bucket is sorted by insertion; a vertex may have any number of edges."""


@njit(cache=True)
def group_half_edges(faces, vertex_count):
    """(order (3 f,), start (e + 1,), forward (3 f,) bool, edge (3 f,)) as in `worker.loading.surface.HalfEdges`.

    faces (f, 3) i8. Edges are in order of (smaller, larger vertex), the half-edges of one in order of their numbers.
    """
    n = 3 * len(faces)
    forward = np.empty(n, np.bool_)
    larger = np.empty(n, np.int64)
    fill = np.zeros(vertex_count + 1, np.int64)
    for h in range(n):
        a, b = faces[h // 3, h % 3], faces[h // 3, (h + 1) % 3]
        forward[h] = a < b
        larger[h] = max(a, b)
        fill[min(a, b) + 1] += 1
    for v in range(vertex_count):
        fill[v + 1] += fill[v]
    begin = fill.copy()
    order = np.empty(n, np.int64)
    for h in range(n):
        v = min(faces[h // 3, h % 3], faces[h // 3, (h + 1) % 3])
        order[fill[v]] = h
        fill[v] += 1
    for v in range(vertex_count):
        _sort_bucket(order[begin[v] : begin[v + 1]], larger)
    edge = np.empty(n, np.int64)
    start = np.empty(n + 1, np.int64)
    edges = 0
    for v in range(vertex_count):
        last = -1
        for i in range(begin[v], begin[v + 1]):
            if larger[order[i]] != last:
                last = larger[order[i]]
                start[edges] = i
                edges += 1
            edge[order[i]] = edges - 1
    start[edges] = n
    return order, start[: edges + 1].copy(), forward, edge


@njit(cache=True)
def _sort_bucket(bucket, larger):
    """Stable sort of the half-edges in place by their larger vertex."""
    if len(bucket) > SHORT:
        bucket[:] = bucket[np.argsort(larger[bucket], kind="mergesort")]
        return
    for i in range(1, len(bucket)):
        h = bucket[i]
        j = i
        while j > 0 and larger[bucket[j - 1]] > larger[h]:
            bucket[j] = bucket[j - 1]
            j -= 1
        bucket[j] = h
