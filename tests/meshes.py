"""Small meshes built in code: (vertices (v, 3) f8, faces (f, 3) i4), closed and oriented outward unless the name says not."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh

from client.shapes import torus_knot, tube
from schemas.conventions import Frame

SHARED = Path(__file__).resolve().parents[2] / "shared" / "data"


def shared(name: str) -> Path:
    """A real mesh beside the checkout; skips the test where there is none."""
    path = SHARED / name
    if not path.exists():
        pytest.skip(f"real mesh {name} is not on this machine")
    return path


def _arrays(mesh: trimesh.Trimesh):
    return np.asarray(mesh.vertices, np.float64), np.asarray(mesh.faces, np.int32)


def sphere(subdivisions: int = 2, radius: float = 1.0, centre=(0.0, 0.0, 0.0)):
    v, f = _arrays(trimesh.creation.icosphere(subdivisions=subdivisions, radius=radius))
    return v + np.asarray(centre), f


def cube(per_side: int = 1):
    """A cube of 12 * per_side^2 faces; coplanar fans where per_side > 1."""
    n = per_side
    index: dict[tuple[int, int, int], int] = {}
    faces = []

    def at(p):
        return index.setdefault(tuple(int(x) for x in p), len(index))

    for axis in range(3):
        u, v = np.eye(3, dtype=int)[(axis + 1) % 3], np.eye(3, dtype=int)[(axis + 2) % 3]
        for side in (0, n):
            for i in range(n):
                for j in range(n):
                    base = np.eye(3, dtype=int)[axis] * side + u * i + v * j
                    a, b, c, d = at(base), at(base + u), at(base + u + v), at(base + v)
                    quad = [[a, b, c], [a, c, d]]
                    faces += quad if side else [q[::-1] for q in quad]
    return np.array(list(index), np.float64) / n, np.array(faces, np.int32)


def blocks(*cells):
    """The surface of unit cubes at integer corners, with whole-number vertices; four faces at an edge where two cubes share only that."""
    filled, index, faces = set(cells), {}, []
    for cell in cells:
        for axis in range(3):
            u, v = np.eye(3, dtype=int)[(axis + 1) % 3], np.eye(3, dtype=int)[(axis + 2) % 3]
            for side in (0, 1):
                step = np.eye(3, dtype=int)[axis] * (2 * side - 1)
                if tuple((np.array(cell) + step).tolist()) in filled:
                    continue
                base = np.array(cell) + np.eye(3, dtype=int)[axis] * side
                a, b, c, d = (index.setdefault(tuple(p.tolist()), len(index)) for p in (base, base + u, base + u + v, base + v))
                quad = [[a, b, c], [a, c, d]]
                faces += quad if side else [q[::-1] for q in quad]
    return np.array(list(index), np.float64), np.array(faces, np.int32)


def sheet(per_side: int = 6, bend: float = 0.2):
    """An open square of 2 * per_side^2 faces in the plane of x and y, bent towards z."""
    n = per_side
    x, y = np.meshgrid(np.arange(n + 1) / n - 0.5, np.arange(n + 1) / n - 0.5)
    vertices = np.column_stack([x.ravel(), y.ravel(), bend * (x**2 - 0.7 * y**2).ravel()])
    i = (np.arange(n)[:, None] * (n + 1) + np.arange(n)).ravel()
    return vertices, np.concatenate([np.column_stack([i, i + 1, i + n + 2]), np.column_stack([i, i + n + 2, i + n + 1])]).astype(np.int32)


def torus(along: int = 24, around: int = 12, radius: float = 1.0, tube_radius: float = 0.35):
    t = np.arange(along) / along * 2 * np.pi
    return tube(np.column_stack([radius * np.cos(t), radius * np.sin(t), 0 * t]), tube_radius, around)


def knot(along: int = 160, around: int = 16):
    return torus_knot(along, around)


def bumpy_sphere(subdivisions: int = 3, amplitude: float = 0.2, seed: int = 0):
    """A star-shaped surface with concavities."""
    v, f = sphere(subdivisions)
    rng = np.random.default_rng(seed)
    k, phase = rng.normal(size=(6, 3)) * 3.0, rng.uniform(0, 2 * np.pi, 6)
    r = 1.0 + amplitude * np.sin(v @ k.T + phase).mean(axis=1) * 2.0
    return v * r[:, None], f


def joined(*meshes):
    """Several meshes as one with several components."""
    vertices, faces, start = [], [], 0
    for v, f in meshes:
        vertices.append(v)
        faces.append(f + start)
        start += len(v)
    return np.concatenate(vertices), np.concatenate(faces).astype(np.int32)


def normalised(mesh):
    """(positions (v, 3) f4 in the normalised frame, faces, Frame)."""
    vertices, faces = mesh
    frame = Frame.around(vertices)
    return frame.to_normalised(vertices).astype(np.float32), faces, frame


def eyes(count: int, seed: int = 0, nearest: float = 1.5, farthest: float = 4.0, orthographic: int = 0):
    """(count + orthographic, 4) f8 homogeneous eyes in the normalised frame, in random directions."""
    rng = np.random.default_rng(seed)
    d = rng.normal(size=(count + orthographic, 3))
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    w = np.concatenate([np.ones(count), np.zeros(orthographic)])
    r = np.where(w > 0, rng.uniform(nearest, farthest, count + orthographic), 1.0)
    return np.column_stack([d * r[:, None], w])
