"""Normals for shading: smooth across gentle edges, separate on the two sides of a crease.

A vertex has one normal for each *smooth group* of its faces: faces that are connected around it over edges that turn by
less than the crease angle. On smooth meshes that is one normal a vertex, under the vertex's own number.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numba import njit

from geometry.topology import corner_normals, directed_edges, face_normals
from geometry.union_find import find_root

CREASE_ANGLE = math.radians(40.0)
"""An edge that turns by more is a crease. Below the 45 degrees of a chamfer, above the 36 of a ten-sided cylinder."""


@dataclass(frozen=True)
class ShadingNormals:
    """normals: (n, 3) f4 unit. normal_vertices: (n,) i4, the vertex each belongs to, ascending. corner_normals: (f, 3) i4,
    the row of `normals` at each corner; equal to the faces where no vertex has two normals."""

    normals: np.ndarray
    normal_vertices: np.ndarray
    corner_normals: np.ndarray

    @property
    def creased(self) -> bool:
        """Whether some vertex has more than one normal."""
        return len(self.normals) > int(self.normal_vertices[-1]) + 1

    def tensors(self) -> dict[str, np.ndarray]:
        """By name, as they are stored: without the rows where every vertex has one normal."""
        rows = {"normal_vertices": self.normal_vertices, "corner_normals": self.corner_normals} if self.creased else {}
        return {"normals": self.normals, **rows}


def shading_normals(positions: np.ndarray, faces: np.ndarray, crease_angle: float = CREASE_ANGLE) -> ShadingNormals:
    """Angle-weighted normals of the smooth groups of (v, 3) positions and (f, 3) i4 faces; every vertex is in some face.

    Only edges of exactly two faces join groups. +z where the faces of a group have no area or cancel.
    """
    p = np.asarray(positions, np.float64)
    unit = face_normals(p, faces)
    half = directed_edges(faces)
    key = half.min(axis=1).astype(np.int64) * len(p) + half.max(axis=1)
    order = np.argsort(key, kind="stable")
    group = _smooth_groups(order, key, unit, math.cos(crease_angle))
    vertex = faces.reshape(-1)
    roots, first = np.unique(group, return_index=True)
    rank = np.argsort(vertex[first], kind="stable")
    number = np.empty(len(roots), np.int32)
    number[rank] = np.arange(len(roots), dtype=np.int32)
    corner = number[np.searchsorted(roots, group)].reshape(-1, 3)
    normals = corner_normals(p, faces, corner, len(roots))
    return ShadingNormals(normals, vertex[first][rank].astype(np.int32), corner)


@njit(cache=True)
def _smooth_groups(order, key, unit, least_cosine):
    """(3 f,) i8: a name of each corner's group. order sorts the half-edges by key, so an edge's are together."""
    corners = len(order)
    parent = np.arange(corners)
    i = 0
    while i < corners:
        j = i + 1
        while j < corners and key[order[j]] == key[order[i]]:
            j += 1
        if j == i + 2:
            h, g = order[i], order[i + 1]
            f, e = h // 3, g // 3
            cosine = unit[f, 0] * unit[e, 0] + unit[f, 1] * unit[e, 1] + unit[f, 2] * unit[e, 2]
            if cosine >= least_cosine:
                h_end, g_end = 3 * f + (h + 1 - 3 * f) % 3, 3 * e + (g + 1 - 3 * e) % 3
                parent[find_root(parent, h)] = find_root(parent, g_end)
                parent[find_root(parent, h_end)] = find_root(parent, g)
        i = j
    for c in range(corners):
        parent[c] = find_root(parent, c)
    return parent
