"""Candidate graph of the tree construction: pairs of mesh edges that share a vertex."""

from __future__ import annotations

import numpy as np
from numba import njit

ALL_PAIRS_VALENCE = 8
"""Up to this many edges at a vertex every two are linked; beyond, only those of a common face, so that links stay linear."""


@njit(cache=True)
def vertex_links(edge_vertices, starts, incident, links):
    """Pairs of edges at vertices of at most ALL_PAIRS_VALENCE edges, into links (l, 2) i4; returns their number.

    starts (v + 1,), incident (2 e,) i4: edges by vertex. With links empty it only counts.
    """
    count = 0
    write = links.shape[0] > 0
    for v in range(starts.shape[0] - 1):
        low, high = starts[v], starts[v + 1]
        if high - low > ALL_PAIRS_VALENCE:
            continue
        for i in range(low, high):
            for j in range(i + 1, high):
                if write:
                    links[count, 0], links[count, 1] = incident[i], incident[j]
                count += 1
    return count


@njit(cache=True)
def face_links(face_edges, edge_vertices, starts, links):
    """Pairs of edges of a face that meet at a vertex with more edges than ALL_PAIRS_VALENCE; counts when links is empty."""
    count = 0
    write = links.shape[0] > 0
    for f in range(face_edges.shape[0]):
        for k in range(3):
            a, b = face_edges[f, k], face_edges[f, (k + 1) % 3]
            v = edge_vertices[a, 0]
            if v not in (edge_vertices[b, 0], edge_vertices[b, 1]):
                v = edge_vertices[a, 1]
            if starts[v + 1] - starts[v] > ALL_PAIRS_VALENCE:
                if write:
                    links[count, 0], links[count, 1] = a, b
                count += 1
    return count


@njit(cache=True)
def edges_of_faces(edge_faces, face_count):
    """(f, 3) i4: the edges of every face, in order of the edge table."""
    table = np.full((face_count, 3), -1, np.int32)
    filled = np.zeros(face_count, np.int32)
    for e in range(edge_faces.shape[0]):
        for s in range(2):
            f = edge_faces[e, s]
            if filled[f] < 3:
                table[f, filled[f]] = e
                filled[f] += 1
    return table
