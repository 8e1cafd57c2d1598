"""Replaying a sequence of edge collapses."""

from __future__ import annotations

import numpy as np
from numba import njit


@njit(cache=True)
def replay(positions, collapse_vertices, collapse_positions, steps):
    """Make the first `steps` collapses: positions (v, 3) f4 move in place; returns (v,) i4, what each vertex has become.

    collapse_vertices: (c, 2) i4 and collapse_positions: (c, 3) f4, the second vertex merging into the first.
    """
    merged = np.arange(positions.shape[0]).astype(np.int32)
    for k in range(steps):
        a = collapse_vertices[k, 0]
        merged[collapse_vertices[k, 1]] = a
        for axis in range(3):
            positions[a, axis] = collapse_positions[k, axis]
    for v in range(merged.shape[0]):
        root = v
        while merged[root] != root:
            root = merged[root]
        node = v
        while merged[node] != root:
            step = merged[node]
            merged[node] = root
            node = step
    return merged
