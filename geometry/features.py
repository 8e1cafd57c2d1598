"""Edges of any triangles by what lies beside them, and which faces are turned the same way.

A boundary edge belongs to one face, or to more than two, where no surface goes on. An inner edge belongs to two; how far normals turn
over it says whether it is sharp. Nothing is asked of the faces: they may be open, touch, or be turned any way.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

from geometry.predicates import orient_sign
from geometry.topology import directed_edges, face_normals


@dataclass(frozen=True)
class Adjacency:
    """What faces alone say of their edges, wherever the vertices are.

    boundary: (b, 2) i4. ending: (n,) i4, the boundary edges of each face: 3 face + corner that they start at.
    inner: (e, 2) i4, as the first of its two faces has it. beside: (e, 2) i4 those faces. beyond: (e,) i4 the corner of the second one
    that is not on the edge. same_way: (e,) bool, whether both faces are turned the same way.
    """

    boundary: np.ndarray
    ending: np.ndarray
    inner: np.ndarray
    beside: np.ndarray
    beyond: np.ndarray
    same_way: np.ndarray


@dataclass(frozen=True)
class Features:
    """Edges of a mesh. boundary, ending, inner, beside, same_way: as in `Adjacency`.

    turn: (e,) f8 cosine of the angle between the normals of the faces beside, -1 for folded flat, 1 for flat. convex: (e,) bool, seen from
    the side that the first face is turned to.
    """

    boundary: np.ndarray
    ending: np.ndarray
    inner: np.ndarray
    beside: np.ndarray
    turn: np.ndarray
    convex: np.ndarray
    same_way: np.ndarray


def find_adjacency(faces: np.ndarray, vertex_count: int) -> Adjacency:
    """Of faces (f, 3) i4 with vertices below vertex_count."""
    half = directed_edges(faces)
    key = half.min(axis=1).astype(np.int64) * vertex_count + half.max(axis=1)
    order = np.argsort(key, kind="stable")
    in_order = key[order]
    start = np.flatnonzero(np.r_[True, in_order[1:] != in_order[:-1]]) if len(order) else np.zeros(0, np.int64)
    count = np.diff(np.r_[start, len(order)])
    first, second = order[start[count == 2]], order[start[count == 2] + 1]
    beside = np.column_stack([first // 3, second // 3]).astype(np.int32)
    inner = half[first].astype(np.int32)
    same_way = half[first, 0] != half[second, 0]
    beyond = faces[beside[:, 1], (second % 3 + 2) % 3]
    boundary, ending = half[order[start[count != 2]]].astype(np.int32), order[np.repeat(count != 2, count)].astype(np.int32)
    return Adjacency(boundary, ending, inner, beside, beyond, same_way)


def find_features(positions: np.ndarray, faces: np.ndarray, known: Adjacency | None = None) -> Features:
    """The edges of (v, 3) f4 positions and (f, 3) i4 faces. known: `find_adjacency` of the faces, where it was found already."""
    found = find_adjacency(faces, len(positions)) if known is None else known
    unit = face_normals(positions, faces)
    beside, same_way = found.beside, found.same_way
    turn = np.einsum("ij,ij->i", unit[beside[:, 0]], unit[beside[:, 1]]) * np.where(same_way, 1.0, -1.0)
    convex = _convex(positions, faces, beside, found.beyond)
    return Features(found.boundary, found.ending, found.inner, beside, np.clip(turn, -1.0, 1.0), convex, same_way)


@njit(cache=True)
def _convex(positions, faces, beside, beyond):
    """(e,) bool: the far corner of the second face is behind the plane of the first."""
    convex = np.empty(len(beyond), np.bool_)
    for i in range(len(beyond)):
        a, b, c = faces[beside[i, 0], 0], faces[beside[i, 0], 1], faces[beside[i, 0], 2]
        x, y, z = np.float64(positions[beyond[i], 0]), np.float64(positions[beyond[i], 1]), np.float64(positions[beyond[i], 2])
        convex[i] = orient_sign(positions[a], positions[b], positions[c], x, y, z, 1.0) < 0
    return convex


@njit(cache=True)
def turned_like_neighbours(face_count, beside, same_way):
    """(f,) u1: 1 for faces to be turned over so that neighbours over the edges beside (e, 2) agree, the first face of each part kept.

    A part without two sides (a Moebius strip) is left with a seam.
    """
    degree = np.zeros(face_count + 1, np.int64)
    for i in range(len(beside)):
        degree[beside[i, 0] + 1] += 1
        degree[beside[i, 1] + 1] += 1
    start = np.cumsum(degree)
    fill = start[:-1].copy()
    edge = np.empty(2 * len(beside), np.int64)
    for i in range(len(beside)):
        for k in range(2):
            edge[fill[beside[i, k]]] = i
            fill[beside[i, k]] += 1
    turned = np.full(face_count, 2, np.uint8)
    queue = np.empty(face_count, np.int64)
    for root in range(face_count):
        if turned[root] != 2:
            continue
        turned[root], queue[0] = 0, root
        head, tail = 0, 1
        while head < tail:
            f = queue[head]
            head += 1
            for j in range(start[f], start[f + 1]):
                i = edge[j]
                g = beside[i, 0] + beside[i, 1] - f
                if turned[g] == 2:
                    turned[g] = turned[f] if same_way[i] else 1 - turned[f]
                    queue[tail] = g
                    tail += 1
    return turned
