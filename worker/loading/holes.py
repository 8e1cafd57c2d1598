"""Close small holes, as Silhouette Clipping (section 6, the bunny's base) needs: all of them or none.

A hole is a loop of edges that have one face. It is small when the loop is at most MAX_LOOP times as long as the bounding box
diagonal of its component, and when the patches of a component together have at most MAX_AREA times its area; so the open
base of a bust, half a sphere or a lone triangle is not closed. Holes of scans are not flat, where cutting ears in a plane
folds over; the patch is the triangulation of least area in space instead (no new vertices).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from geometry.topology import face_components
from schemas.conventions import F8
from worker.kernels.load_fill import triangulate_loop
from worker.loading.surface import Index, Surface

MAX_LOOP = 0.75
MAX_AREA = 0.10
MAX_RIM_EDGES = 50_000
MAX_WORK = 2_000_000_000
"""Sum of the cubes of the loops' edges: a few seconds of triangulation."""


@dataclass(frozen=True)
class Closed:
    """Holes that were closed, and the edges of their loops; all zero where a hole is too large or is no loop."""

    holes: int = 0
    edges: int = 0
    faces: int = 0


def close_holes(surface: Surface) -> tuple[Surface, Closed]:
    """The mesh with every hole closed, or the same mesh when it has none or cannot be closed as a whole."""
    edges = surface.edges
    open_edges = np.flatnonzero(edges.balances != 0)
    if not 0 < len(open_edges) <= MAX_RIM_EDGES or (edges.counts[open_edges] != 1).any():
        return surface, Closed()
    rims = edges.order[edges.start[open_edges]]
    loops = _loops(surface.faces, rims)
    sizes = _Sizes.of(surface)
    if min(map(len, loops)) < 3 or sum(len(loop) ** 3 for loop in loops) > MAX_WORK or not sizes.short(surface, loops):
        return surface, Closed()
    chords = _rim_neighbours(surface.faces, rims)
    patches = [_patch(surface, chords, loop) for loop in loops]
    if not sizes.slight(loops, np.array([area for _, _, area in patches])):
        return surface, Closed()
    faces, corners = (np.concatenate(x) for x in list(zip(*patches, strict=True))[:2])
    closed = surface.extended(faces, corners)
    if closed.edges.balances.any():
        return surface, Closed()
    return closed, Closed(len(loops), len(rims), len(faces))


def _loops(faces: Index, rims: Index) -> list[Index]:
    """Loops of half-edges with one face, in the direction of the patch: each is the half-edges from last to first.

    A vertex where holes touch is passed several times; a loop is cut off each time the walk comes back to a vertex, so no
    loop visits one twice.
    """
    flat = faces.ravel()
    begin, end = flat[rims], faces[rims // 3, (rims + 1) % 3]
    leaving: dict[int, list[int]] = {}
    for i, v in enumerate(end.tolist()):
        leaving.setdefault(v, []).append(i)
    loops: list[Index] = []
    for start in end.tolist():
        while leaving[start]:
            walk, place = [], {start: 0}
            at = start
            while leaving.get(at):
                rim = leaving[at].pop()
                walk.append(rim)
                at = int(begin[rim])
                if at in place:
                    loops.append(rims[walk[place[at] :]])
                    for gone in walk[place[at] + 1 :]:
                        del place[int(end[gone])]
                    del walk[place[at] :]
                else:
                    place[at] = len(walk)
    return loops


def _patch(surface: Surface, chords: dict[int, set[int]], loop: Index) -> tuple[Index, Index, float]:
    """(faces, corners, area) of the patch of one loop."""
    head = loop // 3, (loop + 1) % 3
    vertices, corners = surface.faces[head], surface.corners[head]
    place = {v: i for i, v in enumerate(vertices.tolist())}
    taken = np.zeros((len(loop), len(loop)), bool)
    for v, i in place.items():
        for other in chords[v]:
            if other in place:
                taken[i, place[other]] = True
    triangles, area = triangulate_loop(surface.positions[vertices].astype(np.float64), taken)
    return vertices[triangles], corners[triangles], float(area)


def _rim_neighbours(faces: Index, rims: Index) -> dict[int, set[int]]:
    """For each vertex on a rim, the rim vertices it shares an edge with."""
    on_rim = np.zeros(faces.max() + 1, bool)
    on_rim[faces.ravel()[rims]] = True
    on_rim[faces[rims // 3, (rims + 1) % 3]] = True
    neighbours: dict[int, set[int]] = {int(v): set() for v in np.flatnonzero(on_rim)}
    half = faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    for a, b in half[on_rim[half].all(axis=1)].tolist():
        neighbours[a].add(b)
        neighbours[b].add(a)
    return neighbours


@dataclass(frozen=True)
class _Sizes:
    """Component of each face, and each component's bounding box diagonal and area."""

    component: Index
    diagonal: F8
    area: F8

    @classmethod
    def of(cls, surface: Surface) -> _Sizes:
        faces, p = surface.faces, surface.positions.astype(np.float64)
        component, count = face_components(faces.astype(np.int32), len(p))
        low, high = np.full((count, 3), np.inf), np.full((count, 3), -np.inf)
        for k in range(3):
            np.minimum.at(low, component, p[faces[:, k]])
            np.maximum.at(high, component, p[faces[:, k]])
        a, b, c = (p[faces[:, k]] for k in range(3))
        area = np.bincount(component, np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2.0, count).astype(np.float64)
        return cls(component, np.linalg.norm(high - low, axis=1), area)

    def short(self, surface: Surface, loops: list[Index]) -> bool:
        """Whether no loop is long."""
        rims = np.concatenate(loops)
        p = surface.positions.astype(np.float64)
        step = p[surface.faces[rims // 3, (rims + 1) % 3]] - p[surface.faces[rims // 3, rims % 3]]
        length = np.add.reduceat(np.linalg.norm(step, axis=1), np.cumsum([0] + [len(loop) for loop in loops[:-1]]))
        return bool((length <= MAX_LOOP * self.diagonal[self._home(loops)]).all())

    def slight(self, loops: list[Index], areas: F8) -> bool:
        """Whether no component is patched much."""
        patched = np.bincount(self._home(loops), areas, len(self.area))
        return bool((patched <= MAX_AREA * self.area).all())

    def _home(self, loops: list[Index]) -> Index:
        return self.component[np.array([loop[0] // 3 for loop in loops])].astype(np.int64)
