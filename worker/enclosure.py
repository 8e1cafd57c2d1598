"""Does a hull enclose its original? Decided exactly for the float32 vertices, up to a stated tolerance of what cannot be seen.

Silhouette Clipping, section 3: the hull's positive winding volume contains the original's. It does when no point of the
original's surface that bounds interior lies outside the hull. Over a patch of faces that the hull does not touch the winding
number of the hull is constant: a patch is inside when one point of it is. Of all other faces are tested the vertices, the middles
of edges and faces, every piece of an edge between its crossings with the hull, and what lies around every edge of the hull that
goes through them: a face that is inside at its border and leaves the hull anyway must be run through by such an edge.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from geometry.boxes import build_boxes
from geometry.topology import build_edges, face_components, face_normals
from schemas.conventions import F4, F8, I4
from worker.kernels import bake_boxes, verify_enclosure

Values = npt.NDArray[Any]

TOLERANCE = 2e-7
"""Normalised units a point may lie outside the hull and count as on it: three float32 roundings at the rim of the frame."""
STEPS_IN = (1e-5, 1e-6, 1e-7, 1e-8)
"""Normalised units below the original's surface at which interior is looked for: the shortest, aside included, is outside the hull
wherever the surface is so by more than TOLERANCE, and the longer ones make sure of what is deeper."""
STEP_OUT = STEPS_IN[0]
"""Normalised units beside a crossing at which a face of the original is looked at."""
ASIDE = 5.0
"""Steps towards the middle of the face, for each one below: where faces meet at more than 11 degrees it stays below both."""


MOST_CROSSINGS, CROSSINGS_AN_EDGE = 200_000, 1
"""More between an original and its hull are not looked at: each takes a few winding numbers, and only surfaces that go through
themselves everywhere have as many."""


class NotEnclosedError(ValueError):
    """A point of the original lies outside the hull by `distance` normalised units. point: [x, y, z], normalised."""

    def __init__(self, message: str, point: list[float], distance: float) -> None:
        super().__init__(message)
        self.point, self.distance = point, distance


class UnprovenError(ValueError):
    """The original and the hull cross too often for a proof that the one encloses the other."""


class Solid:
    """A closed oriented mesh with its box hierarchy. positions (v, 3) f4, faces (f, 3) i4."""

    def __init__(self, positions: F4, faces: I4) -> None:
        self.positions, self.faces = positions, faces
        self.order, self.boxes = build_boxes(positions, faces)
        table = build_edges(faces)
        self.edges, self.edge_faces = table.vertices, table.faces
        self.normals = face_normals(positions, faces)

    def winding(self, points: F8) -> tuple[I4, Values]:
        """As `verify_enclosure.winding_numbers`."""
        winding, on = verify_enclosure.winding_numbers(self.positions, self.faces, self.order, self.boxes, points)
        return winding, on

    def height(self, points: F8) -> F8:
        """(n,) f8 distance of points (n, 3) f8; exactly 0 for those in the plane of the face that is closest."""
        face, _, square = bake_boxes.closest_points(self.positions, self.faces, self.order, self.boxes, points)
        side = verify_enclosure.plane_sides(self.positions, self.faces, face, points)
        return np.where((side == 0) & (square <= TOLERANCE**2), 0.0, np.sqrt(square))

    def crossings(self, other: Solid, edges: Values) -> I4:
        """(n, 2) i4: (edge of other, face of this one) pairs that cross; only edges (k,) of other are looked at.

        Raises UnprovenError where there are too many.
        """
        ends = other.positions[other.edges[edges]]
        most = max(MOST_CROSSINGS, CROSSINGS_AN_EDGE * max(len(self.edges), len(other.edges)))
        pairs = np.empty((4096, 2), np.int32)
        while True:
            lines = (np.ascontiguousarray(ends[:, 0]), np.ascontiguousarray(ends[:, 1]))
            count = verify_enclosure.crossings(self.positions, self.faces, self.order, self.boxes, *lines, pairs, most)
            if count > most:
                raise UnprovenError(f"it crosses the original more than {most:,} times: too often to prove that it encloses it")
            if count <= len(pairs):
                return np.column_stack([edges[pairs[:count, 0]], pairs[:count, 1]]).astype(np.int32)
            pairs = np.empty((count, 2), np.int32)

    def contacts(self, other: Solid) -> tuple[Values, Values]:
        """((f,) bool of this one, (g,) bool of the other): faces that may meet the other mesh; all that do are marked."""
        mine, theirs = np.zeros(len(self.faces), np.bool_), np.zeros(len(other.faces), np.bool_)
        pair = (self.positions, self.faces, self.order, self.boxes, other.positions, other.faces, other.order, other.boxes)
        verify_enclosure.contacts(*pair, mine, theirs)
        return mine, theirs


def enclosure_fault(positions: F4, faces: I4, hull_positions: F4, hull_faces: I4) -> int:
    """Raise NotEnclosedError where the hull does not enclose the original; else the number of points outside within TOLERANCE.

    Raises UnprovenError where they cross too often.

    positions (v, 3) f4, faces (f, 3) i4: closed, oriented; hull_positions (hv, 3) f4, hull_faces (hf, 3) i4 as well.
    """
    return fault_between(Solid(positions, faces), Solid(hull_positions, hull_faces))


def fault_between(original: Solid, hull: Solid) -> int:
    """The same for meshes that are tested against several others."""
    touched, hull_touched = original.contacts(hull)
    vertices, faces = original.positions.astype(np.float64), original.faces
    close = touched | _outside_untouched(original, hull, ~touched)
    near = np.flatnonzero(close)
    face_of_vertex = np.full(len(vertices), -1, np.int64)
    face_of_vertex[faces[near].ravel()] = np.repeat(near, 3)
    used = np.flatnonzero(face_of_vertex >= 0)
    grazing = _require_inside(original, hull, vertices[used], face_of_vertex[used], "a vertex of the original lies outside")
    edges = np.flatnonzero(close[original.edge_faces].any(axis=1))
    middles = vertices[original.edges[edges]].mean(axis=1)
    _require_inside(original, hull, middles, original.edge_faces[edges, 0], "an edge of the original leaves it")
    _require_inside(original, hull, vertices[faces[near]].mean(axis=1), near, "a face of the original leaves it")
    _require_inside(original, hull, *_between_crossings(original, hull, edges), "an edge of the original goes through it")
    hull_edges = np.flatnonzero(hull_touched[hull.edge_faces].any(axis=1))
    _require_inside(original, hull, *_around_crossings(original, hull, hull_edges), "an edge of it goes through the original")
    return grazing


def _outside_untouched(original: Solid, hull: Solid, untouched: Values) -> Values:
    """(f,) bool: faces in those connected patches of faces that the hull does not touch, (f,) bool, that lie outside of it."""
    some = np.flatnonzero(untouched)
    outside = np.zeros(len(original.faces), np.bool_)
    labels, _ = face_components(np.ascontiguousarray(original.faces[some]), len(original.positions))
    one = some[np.unique(labels, return_index=True)[1]]
    winding, on = hull.winding(original.positions[original.faces[one, 0]].astype(np.float64))
    outside[some] = ((winding <= 0) & ~on)[labels]
    return outside


def _require_inside(original: Solid, hull: Solid, points: F8, at: Values, message: str) -> int:
    """Points (n, 3) f8 of the original's faces `at` (n,); returns how many are outside within TOLERANCE."""
    winding, on = hull.winding(points)
    outside = np.flatnonzero((winding <= 0) & ~on)
    if not len(outside):
        return 0
    distance = hull.height(points[outside])
    far = np.flatnonzero(distance > TOLERANCE)
    # a surface with no interior behind it, as where the original turns itself inside out, need not be enclosed
    refused = far[_bounds_interior_outside(original, hull, points[outside[far]], at[outside[far]])]
    if len(refused):
        worst = refused[np.argmax(distance[refused])]
        raise NotEnclosedError(message, points[outside[worst]].tolist(), float(distance[worst]))
    return int(np.count_nonzero((distance > 0.0) & (distance <= TOLERANCE)))


def _bounds_interior_outside(original: Solid, hull: Solid, points: F8, at: Values) -> Values:
    """(n,) bool: below points (n, 3) f8 of the original's faces `at` (n,) there is a witness that the hull does not enclose it.

    A witness is a point with a positive winding number in the original and none in the hull, both exact: a normal that means
    nothing (slivers) or another sheet of the original close below (folds) can mislead the search, never the answer.
    """
    found = np.zeros(len(points), np.bool_)
    middle = original.positions[original.faces[at]].astype(np.float64).mean(axis=1) - points
    length = np.linalg.norm(middle, axis=1, keepdims=True)
    for step in STEPS_IN:
        aside = np.divide(ASIDE * step, length, out=np.zeros_like(length), where=length > 0.0)
        below = points + np.minimum(aside, 0.5) * middle - step * original.normals[at]
        inside, outside = original.winding(below)[0] > 0, np.logical_not(hull.winding(below)[0] > 0)
        some = np.flatnonzero(inside & outside)
        found[some[hull.height(below[some]) > 0.5 * TOLERANCE]] = True
    return found


def _between_crossings(original: Solid, hull: Solid, edges: Values) -> tuple[F8, Values]:
    """Middles of the pieces into which the hull's faces cut edges (k,) of the original, and a face beside each."""
    pairs = hull.crossings(original, edges)
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


def _around_crossings(original: Solid, hull: Solid, edges: Values) -> tuple[F8, Values]:
    """Points of the original's faces a step outward from where edges (k,) of the hull go through them."""
    pairs = original.crossings(hull, edges)
    ends = hull.positions[hull.edges[pairs[:, 0]]].astype(np.float64)
    along = _parameters(original, pairs[:, 1], ends)
    points = ends[:, 0] + along[:, None] * (ends[:, 1] - ends[:, 0])
    outward = hull.normals[hull.edge_faces[pairs[:, 0]]].sum(axis=1)
    normal = original.normals[pairs[:, 1]]
    outward -= np.einsum("ni,ni->n", outward, normal)[:, None] * normal
    length = np.linalg.norm(outward, axis=1, keepdims=True)
    step = STEP_OUT * np.divide(outward, length, out=np.zeros_like(outward), where=length > 0.0)
    # not beyond the face: what leaves it through its border is found at its edges
    here, there = (_barycentric(original, pairs[:, 1], at) for at in (points, points + step))
    loss = here - there
    exits = np.divide(np.maximum(here, 0.0), loss, out=np.full_like(here, np.inf), where=loss > 0.0).min(axis=1)
    # on the face, whatever the normal of a sliver is worth
    weights = np.maximum(here - loss * np.minimum(1.0, exits / 2.0)[:, None], 0.0)
    weights /= weights.sum(axis=1, keepdims=True)
    return np.einsum("nk,nki->ni", weights, original.positions[original.faces[pairs[:, 1]]].astype(np.float64)), pairs[:, 1]


def _barycentric(solid: Solid, face: Values, points: F8) -> F8:
    """(n, 3) f8 weights of points (n, 3) f8 in the planes of faces of a solid."""
    a, b, c = (solid.positions[solid.faces[face, k]].astype(np.float64) for k in range(3))
    across = np.cross(b - a, c - a)
    square = np.maximum(np.einsum("ni,ni->n", across, across), np.finfo(np.float64).tiny)
    s = np.einsum("ni,ni->n", np.cross(points - a, c - a), across) / square
    t = np.einsum("ni,ni->n", np.cross(b - a, points - a), across) / square
    return np.stack([1.0 - s - t, s, t], axis=1)


def _parameters(solid: Solid, face: Values, ends: F8) -> F8:
    """(n,) f8 in [0, 1]: where segments with ends (n, 2, 3) f8 meet the planes of faces of a solid."""
    normal = solid.normals[face]
    base = solid.positions[solid.faces[face, 0]].astype(np.float64)
    first = np.einsum("ni,ni->n", ends[:, 0] - base, normal)
    last = np.einsum("ni,ni->n", ends[:, 1] - base, normal)
    change = first - last
    return np.asarray(np.clip(np.divide(first, change, out=np.full_like(first, 0.5), where=change != 0.0), 0.0, 1.0))
