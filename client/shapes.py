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


HOLES_LEVELS = 5
"""Its 92 quads, split five times and halved: 2 * 92 * 4^5 = 188,416 faces, as Holes3 of Silhouette Clipping, Table 1."""


def three_holed_torus(levels: int = HOLES_LEVELS) -> tuple[Vertices, Faces]:
    """Smooth surface of genus 3, three holes in a row: 184 * 4^levels faces, a Catmull-Clark subdivision of a pierced slab."""
    vertices, quads = _pierced_slab()
    for _ in range(levels):
        vertices, quads = catmull_clark(vertices, quads)
    faces = np.stack([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]], axis=1).reshape(-1, 3)
    return vertices, np.ascontiguousarray(faces, np.int32)


def _pierced_slab() -> tuple[Vertices, Faces]:
    """A slab of 10 x 3 x 1 boxes without three pairs of them: 88 vertices, 92 outward quads.

    Seen from above, o is a hole:   . . . . . . . . . .
                                    . o o . o o . o o .
                                    . . . . . . . . . .
    """
    solid = np.ones((10, 3), bool)
    solid[[1, 2, 4, 5, 7, 8], 1] = False
    padded = np.pad(solid, 1)
    corner = np.arange(11 * 4 * 2).reshape(11, 4, 2)
    quads = []
    for i, j in np.argwhere(solid):
        a, b, c, d = ((i, j), (i + 1, j), (i + 1, j + 1), (i, j + 1))
        quads += [[corner[(*p, 1)] for p in (a, b, c, d)], [corner[(*p, 0)] for p in (d, c, b, a)]]
        for start, end, x, y in ((a, b, i, j - 1), (b, c, i + 1, j), (c, d, i, j + 1), (d, a, i - 1, j)):
            if not padded[x + 1, y + 1]:
                quads.append([corner[(*start, 0)], corner[(*end, 0)], corner[(*end, 1)], corner[(*start, 1)]])
    x, y, z = np.meshgrid(np.arange(11.0) - 5.0, [-2.0, -1.0, 1.0, 2.0], [-0.7, 0.7], indexing="ij")
    return np.column_stack([x.ravel(), y.ravel(), z.ravel()]), np.array(quads, np.int32)


def catmull_clark(vertices: Vertices, quads: Faces) -> tuple[Vertices, Faces]:
    """One level of Catmull and Clark (1978) of a closed mesh: (v, 3) and (q, 4) give v + edges + q vertices and 4 q quads."""
    v, q = len(vertices), len(quads)
    ends = np.sort(np.stack([quads, np.roll(quads, -1, axis=1)], axis=-1).reshape(-1, 2), axis=1)
    edges, edge = np.unique(ends, axis=0, return_inverse=True)
    edge = edge.reshape(q, 4)  # of corner k to corner k + 1
    middles = vertices[quads].mean(axis=1)
    beside = np.zeros((len(edges), 3))
    np.add.at(beside, edge, middles[:, None])
    halves = vertices[edges].sum(axis=1)
    valence, around, spokes = np.zeros((v, 1)), np.zeros((v, 3)), np.zeros((v, 3))
    np.add.at(valence, edges, 1.0)
    np.add.at(around, quads, middles[:, None])
    np.add.at(spokes, edges, halves[:, None] / 2.0)
    moved = (around / valence + 2.0 * spokes / valence + (valence - 3.0) * vertices) / valence
    along, across, centre = v + edge, v + np.roll(edge, 1, axis=1), np.repeat(v + len(edges) + np.arange(q), 4).reshape(q, 4)
    split = np.stack([quads, along, centre, across], axis=-1).reshape(-1, 4)
    return np.concatenate([moved, (halves + beside) / 4.0, middles]), split.astype(np.int32)


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
