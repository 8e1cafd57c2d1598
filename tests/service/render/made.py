"""Assets made in code with the real preprocessing."""

from __future__ import annotations

from functools import cache

import numpy as np

from geometry.topology import build_edges, vertex_normals
from schemas.mesh import Capability
from schemas.render import Camera
from service.assets import MeshAsset
from service.camera import resolve_camera
from service.silhouette.extract import SilhouetteTree
from tests import meshes
from worker.bake import bake_maps, hull_normals
from worker.hull import build_hull
from worker.tree import build_tree

SHAPES = {
    "sphere": lambda: meshes.sphere(3),
    "torus": lambda: meshes.torus(32, 16),
    "knot": lambda: meshes.knot(120, 12),
    "bumpy": lambda: meshes.bumpy_sphere(4, 0.5),
    "joined": lambda: meshes.joined(
        meshes.sphere(2, 0.5, (-0.8, 0, 0)), meshes.torus(24, 12, 0.6, 0.2), meshes.sphere(2, 0.3, (0.9, 0.4, 0))
    ),
    "cube": lambda: meshes.cube(2),
    "spindle": lambda: (meshes.sphere(3)[0] * (1.0, 0.12, 0.12), meshes.sphere(3)[1]),
}


def quiet(_: float) -> None:
    """Progress nobody looks at."""


@cache
def clippable(name: str, hull_faces: int = 200) -> MeshAsset:
    """A shape with hull, maps and tree."""
    return prepared(name, SHAPES[name](), hull_faces, None)


def prepared(name, mesh, hull_faces, appearance) -> MeshAsset:
    positions, faces, frame = meshes.normalised(mesh)
    normals = vertex_normals(positions, faces)
    edges = build_edges(faces)
    hull = build_hull(positions, faces, hull_faces, quiet)
    shooting = hull_normals(hull.positions, hull.faces)
    maps = bake_maps(hull.positions, hull.faces, shooting, positions, faces, normals, appearance, 512, quiet)
    tensors = {"positions": positions, "faces": faces, "edge_vertices": edges.vertices, "edge_faces": edges.faces}
    return MeshAsset(
        id=name,
        frame=frame,
        positions=positions,
        faces=faces,
        normals=normals,
        appearance=appearance,
        edges=(edges.vertices, edges.faces),
        hull={"positions": hull.positions, "faces": hull.faces, "normals": shooting},
        maps={"tile_uv": maps.tile_uv, "normal": maps.normal} | ({} if maps.color is None else {"color": maps.color}),
        tree=SilhouetteTree(tensors, grown(positions, faces, edges)),
        clip=Capability(available=True),
    )


def seen_from(asset, eye, side=512):
    """The view of an eye (4,) in the normalised frame that looks at the middle."""
    centre = np.array(asset.frame.centre)
    place = (centre + asset.frame.scale * np.asarray(eye[:3], float)).tolist()
    target = (centre + asset.frame.scale * np.array([0.001, 0.002, -0.003])).tolist()
    more = {} if eye[3] else {"projection": "orthographic", "height": 3.0 * asset.frame.scale}
    return resolve_camera(Camera(eye=place, target=target, up=[0.1, 1.0, 0.2], **more), asset.frame, side, side, asset.radius)


def grown(positions, faces, edges):
    return build_tree(positions, faces, edges.vertices, edges.faces, quiet).tensors()


def tree_tensors(name: str):
    """Tensors of a shape's silhouette tree."""
    asset = clippable(name)
    return grown(asset.positions, asset.faces, build_edges(asset.faces))


@cache
def unclippable(name: str = "bumpy") -> MeshAsset:
    """The same without half of its faces: open, drawn from the original only."""
    positions, faces, frame = meshes.normalised(SHAPES[name]())
    half = np.ascontiguousarray(faces[positions[faces].mean(axis=1)[:, 2] < 0.1])
    reason = "the mesh has boundary edges"
    return MeshAsset(
        f"open {name}", frame, positions, half, vertex_normals(positions, half), None, None, None, None, None,
        Capability(available=False, reason=reason),
    )  # fmt: skip


@cache
def bare(name: str) -> MeshAsset:
    """A closed shape with its edges, and nothing that clipping needs."""
    return without_hull(name, SHAPES[name]())


def without_hull(name, mesh, closed=True) -> MeshAsset:
    """A mesh that cannot be clipped, closed or not."""
    positions, faces, frame = meshes.normalised(mesh)
    edges = build_edges(faces) if closed else None
    return MeshAsset(
        f"bare {name}", frame, positions, faces, vertex_normals(positions, faces), None,
        None if edges is None else (edges.vertices, edges.faces), None, None, None, Capability(available=False, reason="not prepared"),
    )  # fmt: skip
