"""Weld vertices at exactly the same stored position, and drop faces that are none or are there twice."""

from __future__ import annotations

import numpy as np

from schemas.conventions import F4
from worker.loading.surface import Index, Mask, Surface, half_edges


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

    Of faces with the same three vertices in the same direction one stays, except where taking the others away would open an
    edge that has an even number of faces: there they belong to different sheets. Of two in opposite directions one goes
    when their edges have an odd number of faces (it is a duplicate of unknown direction); else both stay, a thin fin.
    """
    group, turn = _coincident(surface.faces)
    if group.max(initial=-1) + 1 == len(group):
        return surface, 0
    alive = np.ones(len(group), bool)
    order = np.lexsort((np.arange(len(group)), turn, group))
    same = (group[order][1:] == group[order][:-1]) & (turn[order][1:] == turn[order][:-1])
    extra = np.zeros(len(group), bool)
    extra[order[1:][same]] = True
    edges = half_edges(surface.faces)
    edge, count = edges.edge.reshape(-1, 3), edges.counts
    alive[extra] = False
    _restore(alive, extra, edge, count)
    left = np.bincount(edge[alive].ravel(), minlength=len(count))
    opposite = _opposite_pairs(group, turn, alive)
    odd = (left[edge[opposite]] % 2).sum(axis=1) >= 2
    alive[opposite[odd]] = False
    return surface.kept(alive), int((~alive).sum())


def _coincident(faces: Index) -> tuple[Index, Index]:
    """((f,) number of each face's vertex set, (f,) direction 0 or 1)."""
    ranked = np.sort(faces, axis=1)
    order = np.lexsort(ranked.T[::-1])
    new = np.ones(len(faces), bool)
    new[1:] = (ranked[order][1:] != ranked[order][:-1]).any(axis=1)
    group = np.empty(len(faces), np.int64)
    group[order] = np.cumsum(new) - 1
    least = faces.argmin(axis=1)
    rows = np.arange(len(faces))
    turn = (faces[rows, (least + 1) % 3] > faces[rows, (least + 2) % 3]).astype(np.int64)
    return group, turn


def _restore(alive: Mask, extra: Mask, edge: Index, count: Index) -> None:
    """Bring back the extras at edges that were even and would be odd, until there is no such edge."""
    while True:
        left = np.bincount(edge[alive].ravel(), minlength=len(count))
        opened = (left % 2 == 1) & (count % 2 == 0)
        back = extra & ~alive & opened[edge].any(axis=1)
        if not back.any():
            return
        alive[back] = True


def _opposite_pairs(group: Index, turn: Index, alive: Mask) -> Index:
    """The second face of each pair that has exactly one living face in either direction."""
    index = np.flatnonzero(alive)
    ups, downs = (np.bincount(group[index[turn[index] == k]], minlength=group.max() + 1) for k in (0, 1))
    paired = (ups == 1) & (downs == 1)
    later = np.full(len(ups), -1)
    np.maximum.at(later, group[index], index)
    return later[paired]
