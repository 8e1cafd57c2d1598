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
from worker.loading.surface import HalfEdges, Index, Surface, half_edges

MAX_LOOP = 0.75
MAX_AREA = 0.10
MAX_LOOP_EDGES = 1000


@dataclass(frozen=True)
class Closed:
    """Holes that were closed, and the edges of their loops; all zero where a hole is too large or is no loop."""

    holes: int = 0
    edges: int = 0
    faces: int = 0


def close_holes(surface: Surface) -> tuple[Surface, Closed]:
    """The mesh with every hole closed, or the same mesh when it has none or cannot be closed as a whole."""
    edges = half_edges(surface.faces)
    open_edges = np.flatnonzero(edges.balances != 0)
    if not len(open_edges) or (edges.counts[open_edges] != 1).any():
        return surface, Closed()
    rims = edges.order[edges.start[open_edges]]
    loops = _loops(surface.faces, rims)
    if any(not 3 <= len(loop) <= MAX_LOOP_EDGES for loop in loops):
        return surface, Closed()
    patches = [_patch(surface, edges, loop) for loop in loops]
    if not all(len(faces) for faces, _, _ in patches) or not _small(surface, loops, np.array([area for _, _, area in patches])):
        return surface, Closed()
    faces, corners = (np.concatenate(x) for x in list(zip(*patches, strict=True))[:2])
    closed = surface.extended(faces, corners)
    if (half_edges(closed.faces).balances != 0).any():
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


def _patch(surface: Surface, edges: HalfEdges, loop: Index) -> tuple[Index, Index, float]:
    """(faces, corners, area) of the patch of one loop; no faces where it cannot be closed."""
    head = loop // 3, (loop + 1) % 3
    vertices, corners = surface.faces[head], surface.corners[head]
    triangles, area = triangulate_loop(surface.positions[vertices].astype(np.float64), _taken(surface.faces, vertices))
    return vertices[triangles], corners[triangles], float(area)


def _taken(faces: Index, vertices: Index) -> np.ndarray:
    """(n, n) whether two loop vertices already share an edge."""
    n = len(vertices)
    number = np.full(faces.max() + 1, -1, np.int64)
    number[vertices] = np.arange(n)
    local = number[faces]
    taken = np.zeros((n, n), bool)
    for k in range(3):
        a, b = local[:, k], local[:, (k + 1) % 3]
        both = (a >= 0) & (b >= 0)
        taken[a[both], b[both]] = taken[b[both], a[both]] = True
    return taken


def _small(surface: Surface, loops: list[Index], areas: F8) -> bool:
    faces, p = surface.faces, surface.positions.astype(np.float64)
    component, count = face_components(faces.astype(np.int32), len(p))
    low, high = np.full((count, 3), np.inf), np.full((count, 3), -np.inf)
    for k in range(3):
        np.minimum.at(low, component, p[faces[:, k]])
        np.maximum.at(high, component, p[faces[:, k]])
    diagonal = np.linalg.norm(high - low, axis=1)
    a, b, c = (p[faces[:, k]] for k in range(3))
    area = np.bincount(component, np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2.0, count)
    home = np.array([component[loop[0] // 3] for loop in loops])
    length = np.array([_length(p, faces, loop) for loop in loops])
    patched = np.bincount(home, areas, count)
    return bool((length <= MAX_LOOP * diagonal[home]).all() and (patched <= MAX_AREA * area).all())


def _length(p: F8, faces: Index, loop: Index) -> float:
    return float(np.linalg.norm(p[faces[loop // 3, loop % 3]] - p[faces[loop // 3, (loop + 1) % 3]], axis=1).sum())
