"""Edges, components and vertex normals of an indexed triangle mesh."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numba import njit

from geometry.union_find import find_root


@dataclass(frozen=True)
class EdgeTable:
    """Edges of a closed oriented 2-manifold.

    vertices: (e, 2) i4, the directed edge. faces: (e, 2) i4, its left face (has the edge in this direction) and its right
    face (has it reversed). Sorted by (min vertex, max vertex); vertices[:, 0] < vertices[:, 1].
    """

    vertices: np.ndarray
    faces: np.ndarray


class NotManifoldError(ValueError):
    """Some edge has not exactly one face on each side; `edges` is a (k, 2) sample of them."""

    def __init__(self, message: str, edges: np.ndarray) -> None:
        super().__init__(message)
        self.edges = edges


def directed_edges(faces: np.ndarray) -> np.ndarray:
    """(f, 3) faces -> (3 f, 2) half-edges; half-edge 3 f + k goes from corner k to corner k + 1."""
    return faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)


def build_edges(faces: np.ndarray) -> EdgeTable:
    """Edge table of (f, 3) i4 faces.

    Raises NotManifoldError when an edge is not shared by exactly two faces of opposite direction.
    """
    half = directed_edges(faces)
    low, high = half.min(axis=1).astype(np.int64), half.max(axis=1).astype(np.int64)
    key = low * (int(faces.max(initial=0)) + 1) + high
    order = np.argsort(key, kind="stable")
    sorted_key = key[order]
    forward = (half[:, 0] < half[:, 1])[order]
    if len(half) % 2 or not (
        np.array_equal(sorted_key[0::2], sorted_key[1::2])
        and np.all(forward[0::2] != forward[1::2])
        and np.all(sorted_key[2::2] != sorted_key[1:-1:2])
    ):
        unique, count = np.unique(key, return_counts=True)
        bad = unique[count != 2]
        if not len(bad):
            same = sorted_key[0::2][forward[0::2] == forward[1::2]]
            bad = same
        base = int(faces.max(initial=0)) + 1
        sample = np.column_stack([bad[:8] // base, bad[:8] % base])
        raise NotManifoldError("an edge is not shared by exactly two faces of opposite direction", sample)
    first, second = order[0::2], order[1::2]
    left = np.where(forward[0::2], first, second)
    right = np.where(forward[0::2], second, first)
    return EdgeTable(
        half[left].astype(np.int32),
        np.column_stack([left // 3, right // 3]).astype(np.int32),
    )


@njit(cache=True)
def face_components(faces, vertex_count):
    """(labels (f,) i4, count): components of faces that share vertices, numbered in order of their first face."""
    parent = np.arange(vertex_count)
    for f in range(faces.shape[0]):
        a = find_root(parent, faces[f, 0])
        for k in range(1, 3):
            b = find_root(parent, faces[f, k])
            if a != b:
                parent[b] = a
    number = np.full(vertex_count, -1, np.int32)
    labels = np.empty(faces.shape[0], np.int32)
    count = 0
    for f in range(faces.shape[0]):
        root = find_root(parent, faces[f, 0])
        if number[root] < 0:
            number[root] = count
            count += 1
        labels[f] = number[root]
    return labels, count


def signed_volume(positions: np.ndarray, faces: np.ndarray) -> float:
    """Signed volume of a closed mesh, in float64, about its first vertex."""
    return float(_six_volumes(np.ascontiguousarray(positions, np.float64), faces) / 6.0) if len(faces) else 0.0


@njit(cache=True, nogil=True)
def _six_volumes(p, faces):
    """Six times the sum of the tetrahedra from the first vertex to each face."""
    total = 0.0
    x, y, z = p[faces[0, 0]]
    for f in range(faces.shape[0]):
        a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
        ax, ay, az = p[a, 0] - x, p[a, 1] - y, p[a, 2] - z
        bx, by, bz = p[b, 0] - x, p[b, 1] - y, p[b, 2] - z
        cx, cy, cz = p[c, 0] - x, p[c, 1] - y, p[c, 2] - z
        total += ax * (by * cz - bz * cy) + ay * (bz * cx - bx * cz) + az * (bx * cy - by * cx)
    return total


def face_normals(positions: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """(f, 3) f8 unit outward normals; zero where the face has no area."""
    return _face_normals(np.ascontiguousarray(positions, np.float64), faces)


@njit(cache=True, nogil=True)
def _face_normals(p, faces):
    """The same of positions (v, 3) f8."""
    out = np.empty((faces.shape[0], 3))
    for f in range(faces.shape[0]):
        a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
        ux, uy, uz = p[b, 0] - p[a, 0], p[b, 1] - p[a, 1], p[b, 2] - p[a, 2]
        vx, vy, vz = p[c, 0] - p[a, 0], p[c, 1] - p[a, 1], p[c, 2] - p[a, 2]
        x, y, z = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
        length = math.sqrt(x * x + y * y + z * z)
        if length > 0.0:
            out[f, 0], out[f, 1], out[f, 2] = x / length, y / length, z / length
        else:
            out[f, 0], out[f, 1], out[f, 2] = 0.0, 0.0, 0.0
    return out


def vertex_normals(positions: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """(v, 3) f4 unit angle-weighted normals; +z where a vertex has no face with area or its faces cancel."""
    return corner_normals(positions, faces, faces, len(positions))


def corner_normals(positions: np.ndarray, faces: np.ndarray, rows: np.ndarray, count: int) -> np.ndarray:
    """(count, 3) f4 unit: row i is the sum of the normals of the corners with rows[f, k] == i, weighted by their angles.

    +z where there are none, or they cancel. rows: (f, 3) i4.
    """
    return _corner_normals(np.ascontiguousarray(positions, np.float64), faces, rows, count)


@njit(cache=True, nogil=True)
def _corner_normals(p, faces, rows, count):
    """The same of positions (v, 3) f8."""
    total = np.zeros((count, 3))
    n = np.empty(3)
    sides, squares = np.empty((3, 3)), np.empty(3)  # side k is opposite to corner k
    for f in range(faces.shape[0]):
        for k in range(3):
            start, end = faces[f, (k + 1) % 3], faces[f, (k + 2) % 3]
            squares[k] = 0.0
            for axis in range(3):
                sides[k, axis] = p[end, axis] - p[start, axis]
                squares[k] += sides[k, axis] * sides[k, axis]
        for axis in range(3):
            i, j = (axis + 1) % 3, (axis + 2) % 3
            n[axis] = sides[2, j] * sides[1, i] - sides[2, i] * sides[1, j]
        length = math.sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2])
        if length == 0.0:
            continue
        for k in range(3):
            i, j = (k + 1) % 3, (k + 2) % 3
            beside = -(sides[i, 0] * sides[j, 0] + sides[i, 1] * sides[j, 1] + sides[i, 2] * sides[j, 2])
            weight = math.atan2(length, beside) / length
            for axis in range(3):
                total[rows[f, k], axis] += n[axis] * weight
    out = np.empty((count, 3), np.float32)
    for i in range(count):
        x, y, z = total[i]
        length = math.sqrt(x * x + y * y + z * z)
        if length > 1e-12:
            out[i, 0], out[i, 1], out[i, 2] = x / length, y / length, z / length
        else:
            out[i, 0], out[i, 1], out[i, 2] = 0.0, 0.0, 1.0
    return out
