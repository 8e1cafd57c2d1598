"""Compiles every kernel of the workers by preprocessing a tiny mesh, so that numba's cache on disk has them."""

from __future__ import annotations

import numpy as np

from geometry.topology import build_edges, face_components, vertex_normals
from schemas.conventions import F4, I4, Array, Frame
from schemas.mesh import PreprocessOptions
from worker.bake import bake_maps, hull_normals
from worker.downloads import hull_glb
from worker.enclosure import Solid
from worker.hull import Hull, build_hull
from worker.levels import hull_levels, silhouette_levels
from worker.load import build
from worker.loading.parsed import Parsed
from worker.tree import build_tree
from worker.verify import verify_artifacts
from worker.verify_levels import verify_inner, verify_level

RINGS, SECTORS = 6, 8
HULL_FACES, TEXELS = 24, 64


def warm_kernels() -> None:
    """Run load's kernels, hull, bake with its downloads, tree, levels and verify once on a small ellipsoid."""
    positions, faces = ellipsoid()
    normals, edges = vertex_normals(positions, faces), build_edges(faces)
    for vertices, triangles in ((positions, faces[1:]), touching_tetrahedra()):  # a hole to close, an edge of four faces
        build(Parsed(vertices.astype(np.float64), triangles, {}), PreprocessOptions(), _silent)
    hull = build_hull(positions, faces, HULL_FACES, _silent)
    across = hull_normals(hull.positions, hull.faces)
    texture: dict[str, Array] = {
        "corner_color": np.full((len(faces), 3, 4), 255, np.uint8),
        "corner_uv": np.zeros((len(faces), 3, 2), np.float32),
        "texture": np.full((2, 2, 4), 255, np.uint8),
    }
    maps = bake_maps(hull.positions, hull.faces, across, positions, faces, normals, texture, TEXELS, _silent)
    hull_glb(hull, maps, Frame((0.0, 0.0, 0.0), 1.0))
    tree = build_tree(positions, faces, edges.vertices, edges.faces, _silent)
    mesh = {"positions": positions, "faces": faces, "normals": normals, "edge_vertices": edges.vertices, "edge_faces": edges.faces}
    coarse = {"positions": hull.positions, "faces": hull.faces, "normals": across}
    verify_artifacts(mesh, coarse, {"tile_uv": maps.tile_uv, "normal": maps.normal}, tree.tensors(), _silent)
    warm_levels(positions, faces, hull)


def warm_levels(positions: F4, faces: I4, hull: Hull) -> None:
    """A level as if the mesh were large, and an inner hull, with their checks."""
    steps, original = (hull.step_vertices, hull.step_positions), Solid(positions, faces)
    (level,) = silhouette_levels(hull_levels(positions, faces, steps, [HULL_FACES], _silent), _silent)
    verify_level(original, level.tensors(), level.tree.tensors())
    inner = build_hull(positions, faces, HULL_FACES, _silent, side="inner")
    verify_inner(original, {name: getattr(inner, name) for name in ("step_vertices", "step_positions", "level_faces", "level_steps")})


def touching_tetrahedra() -> tuple[F4, I4]:
    """(positions (6, 3) f4, faces (8, 3) i4): two tetrahedra that share an edge."""
    points = [[0, 0, 0], [0, 0, 1], [1, 0, 0], [0, 1, 0], [-1, 0, 0], [0, -1, 0]]
    faces = [[0, 1, 2], [0, 2, 3], [0, 3, 1], [1, 3, 2], [0, 1, 4], [0, 4, 5], [0, 5, 1], [1, 5, 4]]
    return np.array(points, np.float32), np.array(faces, np.int32)[:, ::-1].copy()


def start_compiler() -> None:
    """Load one kernel, which starts numba's compiler: half a second that each fork of this process then has behind it."""
    face_components(np.array([[0, 1, 2]], np.int32), 3)


def ellipsoid() -> tuple[F4, I4]:
    """(positions (v, 3) f4, faces (f, 3) i4) of a closed surface about the origin, outward, with all radii different."""
    polar = np.pi * np.arange(1, RINGS) / RINGS
    turn = 2.0 * np.pi * np.arange(SECTORS) / SECTORS
    ring = np.column_stack([np.cos(turn), np.sin(turn), np.zeros(SECTORS)])
    body = np.concatenate([ring * np.sin(p) + [0.0, 0.0, np.cos(p)] for p in polar])
    points = np.concatenate([[[0.0, 0.0, 1.0]], body, [[0.0, 0.0, -1.0]]]) * [0.9, 0.7, 0.5]
    last = len(points) - 1
    faces = []
    for s in range(SECTORS):
        t = (s + 1) % SECTORS
        faces.append([0, 1 + s, 1 + t])
        for r in range(RINGS - 2):
            a, b = 1 + r * SECTORS, 1 + (r + 1) * SECTORS
            faces += [[a + s, b + s, b + t], [a + s, b + t, a + t]]
        bottom = 1 + (RINGS - 2) * SECTORS
        faces.append([bottom + s, last, bottom + t])
    return points.astype(np.float32), np.array(faces, np.int32)


def _silent(_: float) -> None:
    return None


if __name__ == "__main__":
    warm_kernels()
