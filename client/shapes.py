"""Meshes the project makes itself, so that the demo, tests and benchmarks need no files."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

Vertices = npt.NDArray[np.float64]
Faces = npt.NDArray[np.int32]

KNOT_ALONG, KNOT_AROUND = 1936, 48
"""2 * 1936 * 48 = 185,856 faces: the tessellation of the knot in Silhouette Clipping, Table 1."""


def tube(curve: Vertices, radius: float, around: int) -> tuple[Vertices, Faces]:
    """Closed tube about a closed (n, 3) curve: (n * around, 3) vertices and (2 n around, 3) outward faces.

    The frame along the curve is rotation-minimising, its leftover twist spread over the whole length.
    """
    n = len(curve)
    tangent = np.roll(curve, -1, axis=0) - np.roll(curve, 1, axis=0)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    normal = np.empty_like(curve)
    seed = np.eye(3)[np.argmin(np.abs(tangent[0]))]
    normal[0] = np.cross(tangent[0], seed)
    normal[0] /= np.linalg.norm(normal[0])
    for i in range(1, n):
        step = normal[i - 1] - tangent[i] * np.dot(normal[i - 1], tangent[i])
        normal[i] = step / np.linalg.norm(step)
    end = normal[-1] - tangent[0] * np.dot(normal[-1], tangent[0])
    twist = np.arctan2(np.dot(np.cross(end, normal[0]), tangent[0]), np.dot(end, normal[0]))
    phase = np.arange(n)[:, None] / n * twist + np.arange(around)[None, :] / around * 2.0 * np.pi
    binormal = np.cross(tangent, normal)
    ring = np.cos(phase)[..., None] * normal[:, None] + np.sin(phase)[..., None] * binormal[:, None]
    vertices = (curve[:, None] + radius * ring).reshape(-1, 3)
    row, column = np.meshgrid(np.arange(n), np.arange(around), indexing="ij")
    next_row, next_column = (row + 1) % n, (column + 1) % around
    a, b = row * around + column, row * around + next_column
    c, d = next_row * around + column, next_row * around + next_column
    faces = np.stack([np.stack([a, c, b], -1), np.stack([b, c, d], -1)], axis=2).reshape(-1, 3)
    faces = faces[:, ::-1]
    return vertices, np.ascontiguousarray(faces, np.int32)


def torus_knot(along: int = KNOT_ALONG, around: int = KNOT_AROUND, p: int = 2, q: int = 3) -> tuple[Vertices, Faces]:
    """(p, q) torus knot as a tube: 2 * along * around faces."""
    t = np.arange(along) / along * 2.0 * np.pi
    r = 2.0 + np.cos(q * t)
    curve = np.column_stack([r * np.cos(p * t), r * np.sin(p * t), -np.sin(q * t)])
    return tube(curve, 0.45, around)


def write_ply(path: str, vertices: npt.ArrayLike, faces: npt.ArrayLike) -> None:
    """Write a binary little-endian PLY with float32 positions."""
    v = np.asarray(vertices, "<f4")
    f = np.asarray(faces, "<i4")
    rows = np.empty(len(f), np.dtype([("n", "u1"), ("v", "<i4", 3)]))
    rows["n"], rows["v"] = 3, f
    header = (
        f"ply\nformat binary_little_endian 1.0\nelement vertex {len(v)}\n"
        "property float x\nproperty float y\nproperty float z\n"
        f"element face {len(f)}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    with open(path, "wb") as file:  # noqa: PTH123
        file.write(header.encode())
        file.write(v.tobytes())
        file.write(rows.tobytes())
