"""Closed oriented contours from silhouette edges.

This work is based on: Sander et al. 2000, Silhouette Clipping, section 6, where a hash table on source vertices links the
edges. A vertex may have several edges in and as many out, so the contours are not unique; here they are split into loops
that visit no vertex twice, which leaves each loop as short as it can be (fans about short loops are cheap to draw).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from schemas.conventions import I4, Array
from service.kernels import contours as kernels


@dataclass(frozen=True)
class Contours:
    """Closed loops of vertices.

    vertices: (s,) i4, one vertex for each edge: its source; the edge goes to the next vertex of the loop, the last one of a
    loop to the first. offsets: (c + 1,) i4, loop i is vertices[offsets[i]:offsets[i + 1]].
    """

    vertices: I4
    offsets: I4

    def __len__(self) -> int:
        return len(self.offsets) - 1


def link_contours(edges: Array) -> Contours:
    """Link (s, 2) i4 directed edges into closed loops that use every edge once.

    Raises ValueError when at some vertex not as many edges arrive as leave.
    """
    directed = np.ascontiguousarray(edges, np.int32).reshape(-1, 2)
    vertices, offsets, balanced = kernels.simple_loops(directed)
    if not balanced:
        raise ValueError("the edges do not form closed contours")
    return Contours(vertices, offsets)
