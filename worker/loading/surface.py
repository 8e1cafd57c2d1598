"""The mesh between the repair steps, and its half-edges."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import numpy.typing as npt

from schemas.conventions import F4
from worker.kernels.load_half_edges import group_half_edges

Index = npt.NDArray[np.int64]
Mask = npt.NDArray[np.bool_]


@dataclass(frozen=True)
class Surface:
    """An indexed mesh whose corners remember where they came from.

    positions (v, 3) f4 normalised; faces (f, 3) i8 vertices; corners (f, 3) i8: the corner 3 * face + k of the parsed file
    that each corner takes its colour and texture coordinate from.
    """

    positions: F4
    faces: Index
    corners: Index

    @cached_property
    def edges(self) -> HalfEdges:
        """Its half-edges; most steps leave a clean mesh as it is, and share them."""
        return half_edges(self.faces)

    def kept(self, which: Mask | Index) -> Surface:
        """Only the faces of a mask or index array."""
        return replace(self, faces=self.faces[which], corners=self.corners[which])

    def flipped(self, which: Mask) -> Surface:
        """With the faces of a (f,) mask turned round."""
        if not which.any():
            return self
        faces, corners = self.faces.copy(), self.corners.copy()
        faces[which], corners[which] = faces[which][:, [0, 2, 1]], corners[which][:, [0, 2, 1]]
        return replace(self, faces=faces, corners=corners)

    def extended(self, faces: Index, corners: Index) -> Surface:
        """With more faces at the end."""
        return replace(self, faces=np.concatenate([self.faces, faces]), corners=np.concatenate([self.corners, corners]))

    def compact(self) -> tuple[Surface, int]:
        """Without unreferenced vertices, and how many there were."""
        used = np.zeros(len(self.positions), bool)
        used[self.faces] = True
        if used.all():
            return self, 0
        number = np.cumsum(used) - 1
        return Surface(self.positions[used], number[self.faces], self.corners), int(len(used) - used.sum())


@dataclass(frozen=True)
class HalfEdges:
    """Half-edges grouped by undirected edge; half-edge 3 f + k goes from corner k of face f to corner k + 1.

    order (3 f,): half-edges, those of one edge together; start (e + 1,): where each edge's begin in `order`;
    forward (3 f,): whether a half-edge goes from its smaller vertex to the larger; edge (3 f,): its edge.
    """

    order: Index
    start: Index
    forward: Mask
    edge: Index

    @property
    def counts(self) -> Index:
        """(e,) faces at each edge."""
        return np.diff(self.start)

    @property
    def balances(self) -> Index:
        """(e,) forward minus backward half-edges."""
        return np.add.reduceat(np.where(self.forward[self.order], 1, -1), self.start[:-1])


def half_edges(faces: Index) -> HalfEdges:
    """The half-edges of (f, 3) faces without repeated vertices, f > 0."""
    return HalfEdges(*group_half_edges(np.ascontiguousarray(faces, np.int64), int(faces.max()) + 1))
