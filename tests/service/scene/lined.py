"""Scenes with lines, and the same meshes as one, whose visible lines are found in space without a picture."""

from __future__ import annotations

from functools import cache
from itertools import pairwise

import numpy as np

from schemas.render import ProjectTo, SilhouetteRequest
from schemas.scene import SceneRequest, matrix_of
from service.assets import MeshAsset
from service.scene.draw import draw_scene
from service.scene.plan import plan_scene
from service.silhouette.describe import describe_silhouette
from tests import meshes
from tests.service.render.made import without_hull


def corner():
    """Four blocks about a corner, with ridges and valleys, about the origin."""
    vertices, faces = meshes.blocks((0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1))
    return 0.8 * (vertices - 0.8), faces


SHAPES = {
    "ball": lambda: meshes.sphere(3),
    "ring": lambda: meshes.torus(48, 24),
    "knot": lambda: meshes.knot(120, 12),
    "box": lambda: meshes.cube(2),
    "corner": corner,
}
CAMERA = {"eye": [2.5, 2.0, 6.0], "fov_y_deg": 40}
FLAT = {"eye": [2.5, 2.0, 6.0], "projection": "orthographic", "height": 4.4}
CAMERAS = {"perspective": CAMERA, "orthographic": FLAT}
METHODS = ("edge_mesh", "wireframe", "translated", "fattened")
BEHIND = {"rotate": {"axis": [1, 1, 0], "angle_deg": 70}, "translate": [-0.6, 0.2, -2.2], "scale": 1.2}
"""Where an object is half hidden by one at the origin."""
LINKED = {"rotate": {"axis": [1, 0, 0], "angle_deg": 90}, "translate": [1.0, 0.0, 0.0]}
"""Where a ring goes through another one at the origin."""
MIRRORED = {"rotate": {"axis": [1, 0.3, 0], "angle_deg": 90}, "translate": [1.0, 0.0, 0.0], "scale": [-0.9, 1.0, 1.1]}
WHITE = {"color": "#ffffff", "ambient": 1.0}


@cache
def shape(name: str) -> MeshAsset:
    """A closed mesh that is drawn from itself only."""
    return without_hull(f"lined {name}", SHAPES[name]())


def asked(objects, size=(200, 200), background="#ffffff", **fields) -> SceneRequest:
    """A scene of objects, each (mesh, transform) or (mesh, transform, its other fields), white on white where nothing else is said."""
    listed = [{"mesh": mesh, "transform": transform} | (more[0] if more else {}) for mesh, transform, *more in objects]
    return SceneRequest.model_validate(
        {"camera": CAMERA, "shading": WHITE, "width": size[0], "height": size[1], "background": background, "objects": listed} | fields
    )


def planned(objects, assets=None, **fields):
    """The plan of such a scene."""
    request = asked(objects, **fields)
    return plan_scene(request, assets or [shape(item.mesh) for item in request.objects])


def drawn(gpu, objects, assets=None, **fields):
    """The picture of such a scene."""
    return draw_scene(gpu, planned(objects, assets, **fields))


def merged(objects, name: str) -> MeshAsset:
    """All objects as one mesh, in scene units, faces counter-clockwise from outside."""
    request, parts = asked(objects), []
    for item in request.objects:
        asset, matrix = shape(item.mesh), matrix_of(item.transform)
        vertices = asset.frame.to_model(asset.positions) @ matrix[:3, :3].T + matrix[:3, 3]
        mirrored = np.linalg.det(matrix[:3, :3]) < 0.0
        parts.append((vertices, asset.faces[:, ::-1] if mirrored else asset.faces))
    return without_hull(name, meshes.joined(*parts))


def visible_points(asset, camera, kinds, step=0.5, size=(200, 200), **angles):
    """(n, 2) f8 points in pixels, at most `step` apart, of the mesh's lines of those kinds that nothing hides."""
    wanted = SilhouetteRequest.model_validate(
        {"camera": camera, "project": ProjectTo(width=size[0], height=size[1]), "kinds": kinds, "visible_only": True} | angles
    )
    lines, found = describe_silhouette(asset, wanted).lines, [np.empty((0, 2))]
    for polyline, closed in zip(lines.polylines(), lines.closed, strict=True):
        ends = np.vstack([polyline, polyline[:1]]) if closed else polyline
        for a, b in pairwise(ends):
            t = np.linspace(0.0, 1.0, max(2, int(np.linalg.norm(b - a) / step) + 2))
            found.append(a + t[:, None] * (b - a))
    return np.concatenate(found)


def ink(pixels):
    """(n, 2) f8: centres of the pixels that are darker than half, of a picture on white."""
    rows, columns = np.nonzero(pixels[:, :, :3].max(axis=2) < 128)
    return np.column_stack([columns, rows]) + 0.5


def differing(a, b, tolerance=2):
    """Part of the pixels of two pictures whose colours differ by more than the tolerance, of those that are not as the corner is."""
    apart = np.abs(a.astype(int) - b.astype(int)).max(axis=2) > tolerance
    drawn_in = (a != a[0, 0]).any(axis=2) | (b != b[0, 0]).any(axis=2)
    return apart.sum() / max(1, drawn_in.sum())
