"""Scenes of small meshes."""

from __future__ import annotations

from functools import cache

import numpy as np

from geometry.topology import vertex_normals
from schemas.mesh import Capability
from schemas.render import Accuracy
from schemas.scene import SceneRequest
from service.assets import MeshAsset
from tests import meshes
from tests.service.render.made import clippable, prepared

COLORS = ("#ff0000", "#00ff00", "#0000ff", "#ffff00", "#00ffff", "#ff00ff", "#ffffff")
"""The corners of the colour cube but black: mixtures are nearest to what there is most of."""
SMALL = {"ball": lambda: meshes.sphere(1), "box": lambda: meshes.cube(1), "ring": lambda: meshes.torus(16, 8, 1.0, 0.2)}


@cache
def small(name: str) -> MeshAsset:
    """A mesh of a hundred or two faces, quick to test against every ray; an open one is drawn from its original."""
    if name == "open":
        return _open()
    return prepared(name, SMALL[name](), 40, None) if name in SMALL else clippable(name)


def _open() -> MeshAsset:
    """Less than half of a ball, without the rest of what a worker makes."""
    positions, faces, frame = meshes.normalised(meshes.sphere(2))
    bowl = np.ascontiguousarray(faces[positions[faces].mean(axis=1)[:, 2] < 0.1])
    reason = "the mesh has boundary edges"
    normals = vertex_normals(positions, bowl)
    return MeshAsset(
        "open", frame, positions, bowl, normals, None, None, None, None, None, Capability(available=False, reason=reason)
    )  # fmt: skip


def scene(objects, antialias="coverage", source="auto", size=(64, 64), **fields):
    """(request, assets) of objects given as (mesh, transform); each in a colour of its own, without shading."""
    listed = [
        {"mesh": mesh, "transform": transform, "shading": {"color": COLORS[i % len(COLORS)]}} for i, (mesh, transform) in enumerate(objects)
    ]
    request = SceneRequest(
        objects=listed,
        width=size[0],
        height=size[1],
        shading={"ambient": 1.0},
        accuracy=Accuracy(antialias=antialias, source=source),
        **fields,
    )
    return request, [small(mesh) for mesh, _ in objects]


def rotation(rng):
    """A random unit quaternion [x, y, z, w]."""
    q = rng.normal(size=4)
    return (q / np.linalg.norm(q)).tolist()


def turned(angle_deg, axis=(0, 1, 0)):
    """A rotation by axis and angle."""
    return {"axis": list(axis), "angle_deg": angle_deg}
