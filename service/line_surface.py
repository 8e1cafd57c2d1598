"""What finding lines needs of a mesh, made when it is first asked for: any mesh, closed or not."""

from __future__ import annotations

import math
from functools import cached_property

import numpy as np

from geometry.features import Adjacency, Features, find_adjacency, find_features, turned_like_neighbours
from geometry.silhouettes import FacePlanes, face_planes
from schemas.conventions import F4, I4, U1

NO_EDGES, NO_CORNERS = np.zeros((0, 2), np.int32), np.zeros(0, np.int32)
for none in (NO_EDGES, NO_CORNERS):
    none.setflags(write=False)


class LineSurface:
    """positions (v, 3) f4 normalised, faces (f, 3) i4. edges: (vertices, faces beside) (e, 2) i4 of a mesh that is closed and oriented.

    still: the same faces and edges at other positions, whose findings are shared as far as they do not depend on these.
    """

    def __init__(self, positions: F4, faces: I4, edges: tuple[I4, I4] | None, still: LineSurface | None = None) -> None:
        self.positions, self.faces, self._edges, self._still = positions, faces, edges, still

    @cached_property
    def planes(self) -> FacePlanes:
        """Of its faces."""
        return face_planes(self.positions, self.faces)

    @cached_property
    def adjacency(self) -> Adjacency:
        """Its edges, as the faces have them; read-only, as mapped ones are: to kernels another type."""
        if self._still is not None:
            return self._still.adjacency
        found = find_adjacency(self.faces, len(self.positions))
        for array in (found.boundary, found.ending, found.inner, found.beside):
            array.setflags(write=False)
        return found

    @cached_property
    def features(self) -> Features:
        """Its edges, by what is beside them."""
        return find_features(self.positions, self.faces, self.adjacency)

    @property
    def inner(self) -> tuple[I4, I4]:
        """(vertices, faces beside) (e, 2) i4 of the edges that two faces share."""
        return (self.adjacency.inner, self.adjacency.beside) if self._edges is None else self._edges

    @property
    def ending(self) -> I4:
        """(n,) i4: where the surface ends, 3 face + corner that the edge starts at."""
        return self.adjacency.ending if self._edges is None else NO_CORNERS

    @property
    def boundary(self) -> I4:
        """(b, 2) i4 edges where the surface ends."""
        return self.adjacency.boundary if self._edges is None else NO_EDGES

    @cached_property
    def open_vertices(self) -> U1:
        """(v,) u1: 1 at vertices where the surface ends."""
        if self._still is not None:
            return self._still.open_vertices
        found = np.zeros(len(self.positions), np.uint8)
        found[self.boundary.reshape(-1)] = 1
        return found

    @cached_property
    def turned(self) -> U1:
        """(f,) u1: which faces to turn over so that neighbours agree."""
        if self._edges is not None:
            return np.zeros(len(self.faces), np.uint8)
        if self._still is not None:
            return self._still.turned
        return turned_like_neighbours(len(self.faces), self.adjacency.beside, self.adjacency.same_way)

    def sharp(self, least_deg: float, layer: U1 | None, *, convex: bool) -> I4:
        """(e, 2) i4 edges over which normals turn by more than so many degrees: ridges (convex) or valleys.

        layer: (f,) u1, of whose faces edges are wanted; all without.
        """
        found = self.features
        chosen = (found.turn < math.cos(math.radians(least_deg))) & (found.convex == convex)
        if layer is not None:
            chosen &= layer[found.beside].all(axis=1)
        return found.inner[chosen]
