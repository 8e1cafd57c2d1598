"""The edges of any triangles, with all faces about each: one, two, or more, turned any way."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from geometry.topology import directed_edges

NO_EDGE = -1


@dataclass(frozen=True)
class EdgeFans:
    """Edges of faces (f, 3), sorted by (lower vertex, higher vertex).

    vertices: (e, 2) i4, vertices[:, 0] < vertices[:, 1]. starts: (e + 1,) i4 and halves: (h,) i4: the half-edges of edge i are
    halves[starts[i]:starts[i + 1]]; half-edge 3 f + k goes from corner k of face f to corner k + 1. of_half: (3 f,) i4, the edge of
    each half-edge; NO_EDGE for one of no length.
    """

    vertices: np.ndarray
    starts: np.ndarray
    halves: np.ndarray
    of_half: np.ndarray


def edge_fans(faces: np.ndarray) -> EdgeFans:
    """The edges of (f, 3) i4 faces, whatever they form."""
    half = directed_edges(faces)
    low, high = half.min(axis=1).astype(np.int64), half.max(axis=1)
    key = low * (int(faces.max(initial=0)) + 1) + high
    halves = np.argsort(key, kind="stable")
    halves = halves[(low != high)[halves]]
    ordered = key[halves]
    first = np.flatnonzero(np.concatenate([np.ones(min(len(ordered), 1), bool), ordered[1:] != ordered[:-1]]))
    sizes = np.diff(np.append(first, len(ordered)))
    of_half = np.full(len(half), NO_EDGE, np.int32)
    of_half[halves] = np.repeat(np.arange(len(first), dtype=np.int32), sizes)
    ends = halves[first]
    vertices = np.column_stack([low[ends], high[ends]]).astype(np.int32)
    return EdgeFans(vertices, np.append(first, len(ordered)).astype(np.int32), halves.astype(np.int32), of_half)


def faces_about_vertices(faces: np.ndarray, vertex_count: int) -> tuple[np.ndarray, np.ndarray]:
    """(starts (v + 1,) i4, about (3 f,) i4): the faces with vertex i as a corner are about[starts[i]:starts[i + 1]]."""
    corners = faces.ravel()
    about = np.argsort(corners, kind="stable") // 3
    starts = np.concatenate([[0], np.cumsum(np.bincount(corners, minlength=vertex_count))])
    return starts.astype(np.int32), about.astype(np.int32)
