"""Faces without area, decided exactly: turned into faces with area where that changes nothing else.

Such a face cannot simply go: its middle corner b lies on the edge a-c of its neighbour, and without the face the mesh would
be open there. Flipping a-c gives two faces in the neighbour's own plane, and the surface is the same point for point:

            d                     d
          /   \\                  / | \\
        /       \\      ->       /  |  \\
      a ----b---- c            a --b-- c       (a, b, c on one line; a-b-c had no area)

At a boundary there is no neighbour and the face is dropped. A face that cannot be flipped (b-d is an edge already, the
neighbour has no area either, or a-c has not two faces) stays: it is harmless, as no eye ever sees it from behind.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from worker.kernels.load_collinear import collinear
from worker.loading.surface import HalfEdges, Index, Mask, Surface

MAX_ROUNDS = 64


@dataclass(frozen=True)
class Needles:
    """Faces without area: how many were flipped away, dropped at a boundary, and kept."""

    flipped: int
    dropped: int
    kept: int


def remove_needles(surface: Surface) -> tuple[Surface, Needles]:
    """The same surface with as few faces without area as possible."""
    flat = collinear(surface.positions, surface.faces)
    flipped = dropped = 0
    for _ in range(MAX_ROUNDS):
        if not flat.any():
            break
        edges = surface.edges
        longest = _longest_half_edge(surface, np.flatnonzero(flat))
        lone = edges.counts[edges.edge[longest]] == 1
        if 0 < lone.sum() < len(flat):
            gone = np.zeros(len(flat), bool)
            gone[longest[lone] // 3] = True
            dropped += int(gone.sum())
            surface, flat = surface.kept(~gone), flat[~gone]
            continue
        surface, changed = _flip(surface, edges, longest, flat)
        if not len(changed):
            break
        flat[changed] = collinear(surface.positions, surface.faces[changed])
        flipped += len(changed) // 2
    return surface, Needles(flipped, dropped, int(flat.sum()))


def _longest_half_edge(surface: Surface, which: Index) -> Index:
    """The half-edge of each face opposite its middle corner."""
    p = surface.positions[surface.faces[which]].astype(np.float64)
    length = np.linalg.norm(p[:, [1, 2, 0]] - p, axis=2)
    return 3 * which + length.argmax(axis=1)


def _flip(surface: Surface, edges: HalfEdges, longest: Index, flat: Mask) -> tuple[Surface, Index]:
    """Flip the edges of as many of the faces as do not get in each other's way; also the faces changed, two for each."""
    edge = edges.edge[longest]
    sound = (edges.counts[edge] == 2) & (edges.balances[edge] == 0)
    h, edge = longest[sound], edge[sound]
    g = edges.order[edges.start[edge]] + edges.order[edges.start[edge] + 1] - h
    b, d = (surface.faces[x // 3, (x + 2) % 3] for x in (h, g))
    base = surface.faces.max() + 1
    have = surface.faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    keys = np.unique(have.min(axis=1) * base + have.max(axis=1))
    wanted = np.minimum(b, d) * base + np.maximum(b, d)
    free = (b != d) & ~np.isin(wanted, keys) & ~flat[g // 3]
    h, g, wanted = h[free], g[free], wanted[free]
    chosen = _independent(h // 3, g // 3, wanted)
    h, g = h[chosen], g[chosen]
    return _flipped(surface, h, g), np.concatenate([h // 3, g // 3])


def _independent(first: Index, second: Index, wanted: Index) -> Index:
    """Indices of flips that share no face and make no edge twice, the earlier ones before the later."""
    busy: set[int] = set()
    made: set[int] = set()
    chosen = []
    for i, (f, g, key) in enumerate(zip(first.tolist(), second.tolist(), wanted.tolist(), strict=True)):
        if f not in busy and g not in busy and key not in made:
            busy |= {f, g}
            made.add(key)
            chosen.append(i)
    return np.array(chosen, np.int64)


def _flipped(surface: Surface, h: Index, g: Index) -> Surface:
    """Faces (a, c, b) and (c, a, d) become (b, a, d) and (d, c, b), half-edge h from a to c and g back."""
    faces, corners = surface.faces.copy(), surface.corners.copy()
    for array in (faces, corners):
        a, c, b = (array[h // 3, (h + k) % 3] for k in range(3))
        a_too, d = array[g // 3, (g + 1) % 3], array[g // 3, (g + 2) % 3]
        c_too = array[g // 3, g % 3]
        # corners keep to the neighbour's chart, apart from the middle one, which it did not have
        array[h // 3] = np.column_stack([b, a_too if array is corners else a, d])
        array[g // 3] = np.column_stack([d, c_too if array is corners else c, b])
    return replace(surface, faces=faces, corners=corners)
