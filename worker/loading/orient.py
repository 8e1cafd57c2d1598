"""Directions of faces: first all of a patch the same way, then every body outward.

A closed component whose signed volume is negative is turned round, with one exception: where the file's directions agree
everywhere and the component lies inside the solid that the others bound, it is a cavity and stays as it is. A file that is
inside out as a whole (its total volume is negative) is turned round as a whole first, its cavities with it. Components that
are not closed have no inside; they keep the direction of most of their faces in the file.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from geometry.boxes import build_boxes
from geometry.topology import face_components
from schemas.conventions import F4, F8, Array
from worker.kernels import verify_enclosure
from worker.kernels.load_around_edge import neighbours_around
from worker.kernels.load_union import directions
from worker.loading.manifold import MOST_FACES
from worker.loading.surface import HalfEdges, Index, Mask, Surface

MAX_CAVITY_WORK = 200_000_000
"""Faces looked at to tell cavities from bodies, some seconds; beyond it, every component is turned outward."""
MOST_LOOKS = 64
"""Vertices of a component that are looked at to tell whether it is a cavity."""
FLAT = 1e-12
"""Signed volume by (area times extent) below which a component is flat and has no outside."""


@dataclass(frozen=True)
class Consistency:
    """Faces turned, and whether the file's own directions agreed everywhere."""

    turned: int
    agreed: bool
    one_sided: int
    """Patches that no directions suit, such as a Moebius strip."""


def make_consistent(surface: Surface) -> tuple[Surface, Consistency]:
    """Turn the fewer faces of each patch, so that neighbours agree across edges of two faces.

    Edges of an even number of faces that do not balance after that join their patches so that going round the edge, faces
    begin and end a solid in turn.
    """
    edges = surface.edges
    two = np.flatnonzero(edges.counts == 2)
    pairs = np.column_stack([edges.order[edges.start[two]], edges.order[edges.start[two] + 1]])
    turn, bad = _turns(pairs, len(pairs), edges, len(surface.faces))
    after = surface.flipped(turn)
    crooked = _unbalanced_even(after) if (edges.counts > 2).any() else turn[:0]
    if len(crooked):
        around = neighbours_around(surface.positions, surface.faces, edges.forward, edges.order, edges.start, crooked, MOST_FACES)
        turn, bad = _turns(np.concatenate([pairs, around]), len(pairs), edges, len(surface.faces))
        after = surface.flipped(turn)
    return after, Consistency(int(turn.sum()), not turn.any() and not bad, bad)


def _turns(pairs: Index, hard: int, edges: HalfEdges, faces: int) -> tuple[Mask, int]:
    """(f,) the faces to turn, and how many patches contradict themselves; those stay as they are."""
    differ = edges.forward[pairs[:, 0]] == edges.forward[pairs[:, 1]]
    patch, turned, bad = directions(pairs // 3, differ, hard, faces)
    size, ones = np.bincount(patch, minlength=faces), np.bincount(patch, turned, minlength=faces)
    most = (2.0 * ones > size)[patch]
    return (turned != most) & ~bad[patch], int(bad[patch[patch == np.arange(faces)]].sum())


def _unbalanced_even(surface: Surface) -> Index:
    edges = surface.edges
    return np.flatnonzero((edges.counts > 2) & (edges.counts % 2 == 0) & (edges.balances != 0))


def orient_outward(surface: Surface, agreed: bool, all_closed: bool) -> tuple[Surface, int]:
    """Turn closed components outward, and say how many.

    agreed: the file's own directions agree, so cavities are meant. all_closed: every edge is known to balance.
    """
    component, count = face_components(surface.faces.astype(np.int32), len(surface.positions))
    volume, flat = _volumes(surface, component, count)
    closed = ~flat if all_closed else _closed_components(surface, component, count) & ~flat
    turn = np.zeros(count, bool)
    if agreed and volume[closed].sum() < 0.0:
        turn = closed.copy()
    volume = np.where(turn, -volume, volume)
    negative = np.flatnonzero(closed & (volume < 0.0))
    if len(negative):
        turned = surface.flipped(turn[component])
        cavity = _cavities(turned, component, negative, closed) if agreed else np.zeros(len(negative), bool)
        turn[negative[~cavity]] ^= True
    return surface.flipped(turn[component]), int(turn.sum())


def _volumes(surface: Surface, component: Index, count: int) -> tuple[F8, Mask]:
    """Signed volume of each component about its own middle, and which are flat."""
    p = surface.positions.astype(np.float64)
    a, b, c = (p[surface.faces[:, k]] for k in range(3))
    size = np.bincount(component, minlength=count)
    centre = np.column_stack([np.bincount(component, a[:, k], count) / size for k in range(3)])[component]
    a, b, c = a - centre, b - centre, c - centre
    volume = np.bincount(component, np.einsum("ij,ij->i", a, np.cross(b, c)) / 6.0, count).astype(np.float64)
    area = np.bincount(component, np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2.0, count)
    extent = np.zeros(count)
    np.maximum.at(extent, component, np.abs(a).max(axis=1))
    return volume, np.abs(volume) <= FLAT * area * extent


def _closed_components(surface: Surface, component: Index, count: int) -> Mask:
    edges = surface.edges
    closed = np.ones(count, bool)
    closed[component[edges.order[edges.start[:-1]][edges.balances != 0] // 3]] = False
    return closed


def _cavities(surface: Surface, component: Index, negative: Index, closed: Mask) -> Mask:
    """Which of the negative components lie inside the solid that the other closed components bound."""
    solid = closed[component]
    if len(negative) * int(solid.sum()) > MAX_CAVITY_WORK:
        return np.zeros(len(negative), bool)
    faces, label = surface.faces[solid], component[solid]
    found = np.zeros(len(negative), bool)
    for i, c in enumerate(negative):
        found[i] = _is_inside(surface.positions, np.unique(faces[label == c]), faces[label != c].astype(np.int32))
    return found


def _is_inside(positions: F4, vertices: Index, faces: Array) -> bool:
    """Whether at least half of some vertices, but for those on a solid, are inside it, each exactly; where all are on it, it is."""
    order, boxes = build_boxes(positions, faces)
    points = positions[vertices[:MOST_LOOKS]].astype(np.float64)
    winding, on = verify_enclosure.winding_numbers(positions, faces, order, boxes, points)
    # a vertex that touches the wall may have been rounded to either side of it
    return bool(2 * np.count_nonzero(winding[~on] >= 1) >= np.count_nonzero(~on))
