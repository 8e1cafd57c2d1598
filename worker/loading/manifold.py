"""Take apart edges of more than two faces, and vertices of more than one fan, without moving anything.

Based on the cutting of Gueziec, Taubin, Lazarus and Horn, "Cutting and Stitching: Converting Sets of Polygons to Manifold
Surfaces" (2001), with one departure: where they cut every such edge open, its faces are paired here so that a closed mesh
stays closed. Around the edge, faces that bound the same solid wedge belong together, so bodies that touch come apart:

         \\ 2    3 /          going round, faces open (1, 3) and close (2, 4) the solid;
      solid\\    /            brackets matched on that ring never cross: 1-2 and 3-4
            \\  /   solid
      1 -----  -------- 4
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from geometry.topology import face_components
from worker.kernels.load_around_edge import pair_half_edges
from worker.kernels.load_union import fans
from worker.loading.double_edges import part_double_edges
from worker.loading.surface import Index, Mask, Surface, half_edges

MOST_FACES = 256
"""Faces at one edge that are still taken apart; more is no solid's edge, and sorting them would take long."""


MAX_ROUNDS = 6
"""Ways of pairing, and then rounds of the last resort, that are tried; real meshes need two of each."""


@dataclass(frozen=True)
class Split:
    """What was taken apart: edges of more than two faces, and the last resort's doings (see `double_edges`)."""

    edges: int
    halved_faces: int
    removed_fins: int


def split_manifold(surface: Surface) -> tuple[Surface, Split]:
    """A mesh of the same faces in which every edge has two faces and every vertex one fan; all edges must balance.

    Edges of more than MOST_FACES faces stay as they are.
    """
    edges = surface.edges
    counts = edges.counts
    joined = np.zeros(len(counts), bool)
    best: tuple[int, Surface, Index] | None = None
    for _ in range(MAX_ROUNDS):
        mates = pair_half_edges(surface.positions, surface.faces, edges.forward, edges.order, edges.start, joined, MOST_FACES)
        result = _separated(surface, fans(mates))
        if not (counts > 2).any():
            return result, Split(0, 0, 0)
        double = _double_edges(result.faces, mates)
        if best is None or double.sum() < best[0]:
            best = int(double.sum()), result, mates
        if not double.any():
            break
        # both ends keep these faces together across the gaps, so pairing across the gaps is what separates them
        joined[np.unique(edges.edge[double])] ^= True
    assert best is not None
    left, result, mates = best
    halved = removed = 0
    for _ in range(MAX_ROUNDS):
        if not left:
            break
        result, mates, more_halved, more_removed = part_double_edges(result, mates)
        result = _separated(result, fans(mates))
        halved, removed = halved + more_halved, removed + more_removed
        left = int(_double_edges(result.faces, mates).sum()) if more_halved + more_removed else 0
    return result, Split(int(((counts > 2) & (counts <= MOST_FACES)).sum()), halved, removed)


def _separated(surface: Surface, fan: Index) -> Surface:
    """One vertex a fan; the first fan of a vertex keeps its number, the others follow at the end."""
    vertex = surface.faces.ravel()
    roots = np.flatnonzero(fan == np.arange(len(fan)))
    first = np.full(len(surface.positions), len(fan))
    np.minimum.at(first, vertex[roots], roots)
    others = roots[first[vertex[roots]] != roots]
    number = np.full(len(fan), -1, np.int64)
    if not len(others):
        return surface
    number[roots] = vertex[roots]
    number[others] = len(surface.positions) + np.arange(len(others))
    return Surface(
        np.concatenate([surface.positions, surface.positions[vertex[others]]]),
        number[fan].reshape(-1, 3),
        surface.corners,
    )


def _double_edges(faces: Index, mates: Index) -> Mask:
    """Paired half-edges whose edge still has more than two faces."""
    edges = half_edges(faces)
    return (edges.counts[edges.edge] > 2) & (mates >= 0)


def drop_fins(surface: Surface) -> tuple[Surface, int]:
    """Without components of two faces, the two sides of one triangle, beside components that have more; also their faces.

    They enclose nothing, are debris of simplified scans, and no coarse hull could ever be made coarser there.
    """
    component, count = face_components(surface.faces.astype(np.int32), len(surface.positions))
    fin = np.bincount(component, minlength=count) == 2
    if not fin.any() or fin.all():
        return surface, 0
    return surface.kept(~fin[component]), 2 * int(fin.sum())
