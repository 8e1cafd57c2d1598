"""What finding lines needs of a mesh, made when it is first asked for: any mesh, closed or not."""

from __future__ import annotations

import math
from functools import cached_property

import numpy as np

from geometry.features import Features, find_features, turned_like_neighbours
from geometry.silhouettes import FacePlanes, face_planes
from schemas.conventions import F4, I4, U1

NO_EDGES, NO_CORNERS = np.zeros((0, 2), np.int32), np.zeros(0, np.int32)
for none in (NO_EDGES, NO_CORNERS):
    none.setflags(write=False)


class LineSurface:
    """positions (v, 3) f4 normalised, faces (f, 3) i4. edges: (vertices, faces beside) (e, 2) i4 of a mesh that is closed and oriented."""

    def __init__(self, positions: F4, faces: I4, edges: tuple[I4, I4] | None) -> None:
        self.positions, self.faces, self._edges = positions, faces, edges

    @cached_property
    def planes(self) -> FacePlanes:
        """Of its faces."""
        return face_planes(self.positions, self.faces)

    @cached_property
    def features(self) -> Features:
        """Its edges, by what is beside them; read-only, as mapped ones are: to kernels another type."""
        found = find_features(self.positions, self.faces)
        for array in (found.boundary, found.ending, found.inner, found.beside):
            array.setflags(write=False)
        return found

    @property
    def inner(self) -> tuple[I4, I4]:
        """(vertices, faces beside) (e, 2) i4 of the edges that two faces share."""
        return (self.features.inner, self.features.beside) if self._edges is None else self._edges

    @property
    def ending(self) -> I4:
        """(n,) i4: where the surface ends, 3 face + corner that the edge starts at."""
        return self.features.ending if self._edges is None else NO_CORNERS

    @property
    def boundary(self) -> I4:
        """(b, 2) i4 edges where the surface ends."""
        return self.features.boundary if self._edges is None else NO_EDGES

    @cached_property
    def open_vertices(self) -> U1:
        """(v,) u1: 1 at vertices where the surface ends."""
        found = np.zeros(len(self.positions), np.uint8)
        found[self.boundary.reshape(-1)] = 1
        return found

    @cached_property
    def turned(self) -> U1:
        """(f,) u1: which faces to turn over so that neighbours agree."""
        if self._edges is not None:
            return np.zeros(len(self.faces), np.uint8)
        return turned_like_neighbours(len(self.faces), self.features.beside, self.features.same_way)

    def sharp(self, least_deg: float, layer: U1 | None, *, convex: bool) -> I4:
        """(e, 2) i4 edges over which normals turn by more than so many degrees: ridges (convex) or valleys.

        layer: (f,) u1, of whose faces edges are wanted; all without.
        """
        found = self.features
        chosen = (found.turn < math.cos(math.radians(least_deg))) & (found.convex == convex)
        if layer is not None:
            chosen &= layer[found.beside].all(axis=1)
        return found.inner[chosen]
