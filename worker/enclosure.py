"""Does a hull enclose its original? Decided exactly for the float32 vertices, up to a stated tolerance of what cannot be seen.

Silhouette Clipping, section 3: the hull's positive winding volume contains the original's. It does when no point of the
original's surface that bounds interior lies outside the hull. Tested are all vertices, the middles of edges and faces, every
piece of an edge of the original between its crossings with the hull, and the original's faces around every edge of the hull
that goes through them: a face that is inside at its border and leaves the hull anyway must be run through by such an edge.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from geometry.topology import build_edges, face_normals
from schemas.conventions import F4, F8, I4
from worker.kernels import bake_boxes, verify_enclosure

Values = npt.NDArray[Any]

TOLERANCE = 2e-7
"""Normalised units a point may lie outside the hull and count as on it: three float32 roundings at the rim of the frame."""
STEP_IN = 1e-5
"""Normalised units below the original's surface at which it is asked whether there is interior at all."""


class NotEnclosedError(ValueError):
    """A point of the original lies outside the hull by `distance` normalised units. point: [x, y, z], normalised."""

    def __init__(self, message: str, point: list[float], distance: float) -> None:
        super().__init__(message)
        self.point, self.distance = point, distance


class _Solid:
    """A closed oriented mesh with its box hierarchy."""

    def __init__(self, positions: F4, faces: I4) -> None:
        self.positions, self.faces = positions, faces
        self.order, self.boxes = bake_boxes.build_boxes(positions, faces)
        table = build_edges(faces)
        self.edges, self.edge_faces = table.vertices, table.faces
        self.normals = face_normals(positions, faces)

    def winding(self, points: F8) -> tuple[I4, Values]:
        winding, on = verify_enclosure.winding_numbers(self.positions, self.faces, self.order, self.boxes, points)
        return winding, on

    def height(self, points: F8) -> F8:
        """(n,) f8 distance of points (n, 3) f8; exactly 0 for those in the plane of the face that is closest."""
        face, _, square = bake_boxes.closest_points(self.positions, self.faces, self.order, self.boxes, points)
        side = verify_enclosure.plane_sides(self.positions, self.faces, face, points)
        return np.where((side == 0) & (square <= TOLERANCE**2), 0.0, np.sqrt(square))

    def crossings(self, other: _Solid) -> I4:
        """(n, 2) i4: (edge of other, face of this one) pairs that cross."""
        ends = other.positions[other.edges]
        pairs = np.empty((4096, 2), np.int32)
        while True:
            lines = (np.ascontiguousarray(ends[:, 0]), np.ascontiguousarray(ends[:, 1]))
            count = verify_enclosure.crossings(self.positions, self.faces, self.order, self.boxes, *lines, pairs)
            if count <= len(pairs):
                return np.asarray(pairs[:count])
            pairs = np.empty((count, 2), np.int32)


def enclosure_fault(positions: F4, faces: I4, hull_positions: F4, hull_faces: I4) -> int:
    """Raise NotEnclosedError where the hull does not enclose the original; else the number of points outside within TOLERANCE.

    positions (v, 3) f4, faces (f, 3) i4: closed, oriented; hull_positions (hv, 3) f4, hull_faces (hf, 3) i4 as well.
    """
    original, hull = _Solid(positions, faces), _Solid(hull_positions, hull_faces)
    vertices = positions.astype(np.float64)
    at_edge = original.edge_faces[:, 0]
    face_of_vertex = np.zeros(len(positions), np.int64)
    face_of_vertex[faces.ravel()] = np.repeat(np.arange(len(faces)), 3)
    used = np.unique(faces)
    grazing = _require_inside(original, hull, vertices[used], face_of_vertex[used], "a vertex of the original lies outside")
    _require_inside(original, hull, vertices[original.edges].mean(axis=1), at_edge, "an edge of the original leaves it")
    _require_inside(original, hull, vertices[faces].mean(axis=1), np.arange(len(faces)), "a face of the original leaves it")
    _require_inside(original, hull, *_between_crossings(original, hull), "an edge of the original goes through it")
    _require_inside(original, hull, *_around_crossings(original, hull), "an edge of it goes through the original")
    return grazing


def _require_inside(original: _Solid, hull: _Solid, points: F8, at: Values, message: str) -> int:
    """Points (n, 3) f8 of the original's faces `at` (n,); returns how many are outside within TOLERANCE."""
    winding, on = hull.winding(points)
    outside = np.flatnonzero((winding <= 0) & ~on)
    if not len(outside):
        return 0
    distance = hull.height(points[outside])
    far = distance > TOLERANCE
    if np.any(far):
        # a surface with no interior behind it, as where the original turns itself inside out, need not be enclosed
        below = points[outside[far]] - STEP_IN * original.normals[at[outside[far]]]
        bounding = original.winding(below)[0] > 0
        if np.any(bounding):
            worst = int(np.argmax(np.where(bounding, distance[far], -1.0)))
            raise NotEnclosedError(message, points[outside[far][worst]].tolist(), float(distance[far][worst]))
    return int(np.count_nonzero((distance > 0.0) & ~far))


def _between_crossings(original: _Solid, hull: _Solid) -> tuple[F8, Values]:
    """Middles of the pieces into which the hull's faces cut the original's edges, and a face beside each."""
    pairs = hull.crossings(original)
    along = _parameters(hull, pairs[:, 1], original.positions[original.edges[pairs[:, 0]]].astype(np.float64))
    cut = np.unique(pairs[:, 0])
    edge = np.concatenate([pairs[:, 0], cut, cut])
    along = np.concatenate([along, np.zeros(len(cut)), np.ones(len(cut))])
    order = np.lexsort((along, edge))
    edge, along = edge[order], along[order]
    same = edge[1:] == edge[:-1]
    middle, edge = ((along[1:] + along[:-1]) / 2.0)[same], edge[1:][same]
    ends = original.positions[original.edges[edge]].astype(np.float64)
    points = ends[:, 0] + middle[:, None] * (ends[:, 1] - ends[:, 0])
    return points, original.edge_faces[edge, 0]


def _around_crossings(original: _Solid, hull: _Solid) -> tuple[F8, Values]:
    """Points of the original's faces a step outward from where an edge of the hull goes through them."""
    pairs = original.crossings(hull)
    ends = hull.positions[hull.edges[pairs[:, 0]]].astype(np.float64)
    along = _parameters(original, pairs[:, 1], ends)
    points = ends[:, 0] + along[:, None] * (ends[:, 1] - ends[:, 0])
    outward = hull.normals[hull.edge_faces[pairs[:, 0]]].sum(axis=1)
    normal = original.normals[pairs[:, 1]]
    outward -= np.einsum("ni,ni->n", outward, normal)[:, None] * normal
    length = np.linalg.norm(outward, axis=1, keepdims=True)
    step = STEP_IN * np.divide(outward, length, out=np.zeros_like(outward), where=length > 0.0)
    # not beyond the face: what leaves it through its border is found at its edges
    here, there = (_barycentric(original, pairs[:, 1], at) for at in (points, points + step))
    loss = here - there
    exits = np.divide(np.maximum(here, 0.0), loss, out=np.full_like(here, np.inf), where=loss > 0.0).min(axis=1)
    return points + step * np.minimum(1.0, exits / 2.0)[:, None], pairs[:, 1]


def _barycentric(solid: _Solid, face: Values, points: F8) -> F8:
    """(n, 3) f8 weights of points (n, 3) f8 in the planes of faces of a solid."""
    a, b, c = (solid.positions[solid.faces[face, k]].astype(np.float64) for k in range(3))
    across = np.cross(b - a, c - a)
    square = np.maximum(np.einsum("ni,ni->n", across, across), np.finfo(np.float64).tiny)
    s = np.einsum("ni,ni->n", np.cross(points - a, c - a), across) / square
    t = np.einsum("ni,ni->n", np.cross(b - a, points - a), across) / square
    return np.stack([1.0 - s - t, s, t], axis=1)


def _parameters(solid: _Solid, face: Values, ends: F8) -> F8:
    """(n,) f8 in [0, 1]: where segments with ends (n, 2, 3) f8 meet the planes of faces of a solid."""
    normal = solid.normals[face]
    base = solid.positions[solid.faces[face, 0]].astype(np.float64)
    first = np.einsum("ni,ni->n", ends[:, 0] - base, normal)
    last = np.einsum("ni,ni->n", ends[:, 1] - base, normal)
    change = first - last
    return np.asarray(np.clip(np.divide(first, change, out=np.full_like(first, 0.5), where=change != 0.0), 0.0, 1.0))
