"""Weld vertices at exactly the same stored position, and drop faces that are none or are there twice."""

from __future__ import annotations

import numpy as np

from schemas.conventions import F4
from worker.kernels.load_union import directions
from worker.loading.surface import Index, Mask, Surface


def weld(positions: F4) -> tuple[Index, Index]:
    """(kept (k,) indices, number (n,)): vertices of equal float32 positions become one, in order of first appearance.

    positions (n, 3) f4; negative zeros count as zeros. Kept vertex number[i] stands for vertex i.
    """
    bits = np.ascontiguousarray(positions + np.float32(0.0)).view(np.uint32).astype(np.uint64)
    order = np.lexsort((bits[:, 2], bits[:, 0] << np.uint64(32) | bits[:, 1]))
    ranked = bits[order]
    new = np.ones(len(order), bool)
    new[1:] = (ranked[1:] != ranked[:-1]).any(axis=1)
    first = order[new]  # the sort is stable, so the first of a group is its smallest index
    group = np.empty(len(order), np.int64)
    group[order] = np.cumsum(new) - 1
    rank = np.empty(len(first), np.int64)
    by_appearance = np.argsort(first)
    rank[by_appearance] = np.arange(len(first))
    return first[by_appearance], rank[group]


def drop_collapsed(surface: Surface) -> tuple[Surface, int]:
    """Without faces that name a vertex twice, and how many there were."""
    a, b, c = surface.faces.T
    good = (a != b) & (b != c) & (c != a)
    return (surface, 0) if good.all() else (surface.kept(good), int((~good).sum()))


def drop_duplicates(surface: Surface) -> tuple[Surface, int]:
    """Without faces that are there twice, and how many there were.

    Of the faces with the same three vertices the first stays. Patches of the others, as they hang together across edges, go
    - unless that would leave an edge with an odd number of faces that had an even one: there they belong to different
      sheets, such as the wall where two bodies touch or the two sides of a fin;
    - and where some have the opposite direction, only if an edge with an odd number of faces gets an even one: a closed
      double wall is no mistake.
    """
    extra, opposite = _later_coincident(surface.faces)
    if not extra.any():
        return surface, 0
    edges = surface.edges
    edge = edges.edge.reshape(-1, 3)
    odd_before = edges.counts % 2 == 1
    odd_after = np.bincount(edge[~extra].ravel(), minlength=len(edges.counts)) % 2 == 1
    patch = _patches(edge, extra)
    opens, closes, two_sided = (np.zeros(len(extra), bool) for _ in range(3))
    opens[patch[extra & (odd_after & ~odd_before)[edge].any(axis=1)]] = True
    closes[patch[extra & (odd_before & ~odd_after)[edge].any(axis=1)]] = True
    two_sided[patch[opposite]] = True
    gone = extra & ~opens[patch] & (closes | ~two_sided)[patch]
    return surface.kept(~gone), int(gone.sum())


def _patches(edge: Index, which: Mask) -> Index:
    """(f,) a number shared by those of the faces `which` that hang together across edges; edge (f, 3)."""
    faces = np.flatnonzero(which)
    sides = edge[faces].ravel()
    order = np.argsort(sides, kind="stable")
    owner, sides = np.repeat(faces, 3)[order], sides[order]
    follow = sides[1:] == sides[:-1]
    pairs = np.column_stack([owner[:-1][follow], owner[1:][follow]])
    return directions(pairs, np.zeros(len(pairs), bool), 0, len(which))[0]


def _later_coincident(faces: Index) -> tuple[Mask, Mask]:
    """(f,) whether an earlier face has the same three vertices, and whether the first of those has the other direction."""
    ranked = np.sort(faces, axis=1)
    order = np.lexsort(ranked.T[::-1])
    ranked = ranked[order]
    same = (ranked[1:] == ranked[:-1]).all(axis=1)
    later, opposite = np.zeros(len(faces), bool), np.zeros(len(faces), bool)
    later[order[1:]] = same
    first = np.maximum.accumulate(np.where(np.append(True, ~same), np.arange(len(faces)), 0))
    least = faces.argmin(axis=1)
    rows = np.arange(len(faces))
    rising = faces[rows, (least + 1) % 3] < faces[rows, (least + 2) % 3]
    opposite[order] = rising[order] != rising[order[first]]
    return later, opposite
