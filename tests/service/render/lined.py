"""Pictures with lines, and slow answers to where lines are and which of them are seen."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

from geometry.topology import NotManifoldError, build_edges, vertex_normals
from schemas.lines import Lines
from schemas.mesh import Capability
from schemas.render import Accuracy, RenderRequest, Shading
from service.assets import MeshAsset
from service.camera import View, project, resolve_camera, to_pixels
from service.render.frame import FRAME, tiles_of
from service.render.passes.edge_mesh import draw_lines_of
from service.render.plan import plan_frame
from service.render.state import FrameState, parse_color
from tests import meshes

WHITE = Shading(color="#ffffff", ambient=1.0)


@dataclass
class Lined:
    """A picture (h, w, 4) u1 with its view, and what the GL was made to do for its lines."""

    pixels: np.ndarray
    view: View
    work: object


def drawn_with_lines(gpu, asset, lines, *, mesh=None, antialias="none", size=(200, 200), background="#ffffff", **fields) -> Lined:
    """The original with lines over it; mesh: an edge mesh instead of the asset's own."""
    accuracy = Accuracy(source="original", antialias=antialias)
    fields = {"shading": WHITE, "lines": Lines(**lines)} | fields
    request = RenderRequest(width=size[0], height=size[1], accuracy=accuracy, background=background, **fields)
    view = resolve_camera(request.camera, asset.frame, *size, asset.radius)
    plan = plan_frame(request, asset, view, gpu.costs)
    color = None if background == "transparent" else parse_color(background)
    frame = FrameState(gpu, asset, request, plan, view, color, area=plan.area)
    work = gpu.gl.work - gpu.gl.work
    steps = [step for step in FRAME if step.name in plan.passes]
    for step in steps:
        if not step.each_tile:
            step.make(frame)
    for tile in tiles_of(plan, frame.area):
        frame.tile = tile
        for step in steps:
            if not step.each_tile:
                continue
            before = gpu.gl.work
            draw_lines_of(frame, mesh, request.lines) if step.name == "edge_mesh" and mesh is not None else step.make(frame)
            work += gpu.gl.work - before if step.name == "edge_mesh" else work - work
    gpu.gl.check()
    return Lined(frame.image, view, work)


def asset_of(mesh, name) -> MeshAsset:
    """A mesh, closed or not, that is drawn from itself only."""
    positions, faces, frame = meshes.normalised(mesh)
    try:
        table = build_edges(faces)
        edges = (table.vertices, table.faces)
    except NotManifoldError:
        edges = None
    reason = Capability(available=False, reason="it has no hull")
    normals = vertex_normals(positions, faces)
    return MeshAsset(f"lined {name}", frame, positions, faces, normals, None, edges, None, None, None, reason)


def along_edges(view, positions, ends, step=0.5):
    """Points about every `step` pixels of the edges (e, 2): (points (n, 3) f8, edge (n,), t (n,)); of parts before the eye."""
    p = positions.astype(np.float64)
    pixels = to_pixels(view, project(view, p))
    length = np.linalg.norm(pixels[ends[:, 1]] - pixels[ends[:, 0]], axis=1)
    count = np.maximum(np.nan_to_num(np.ceil(length / step), nan=1000.0), 2).astype(int)
    edge = np.repeat(np.arange(len(ends)), count)
    t = (np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count) + 0.5) / count[edge]
    return p[ends[edge, 0]] + t[:, None] * (p[ends[edge, 1]] - p[ends[edge, 0]]), edge, t


def hidden(view, positions, faces, points, shift=(0.0, 0.0), tolerance=1e-4):
    """(n,) bool: whether some face is nearer than the point, by more than tolerance (normalised units), where the image shows it,
    shifted by (x, y) pixels. Every face is tried for every point.
    """
    clip, seen = project(view, positions), project(view, points)
    corners, at = to_pixels(view, clip)[faces], to_pixels(view, seen) + np.asarray(shift)
    depth = clip[:, 2] if view.orthographic else clip[:, 3]
    own = seen[:, 2] if view.orthographic else seen[:, 3]
    scale = np.linalg.norm(view.matrix[2 if view.orthographic else 3, :3])
    # what is linear in the image: depth, or one over the distance along the axis
    linear = depth if view.orthographic else 1.0 / depth
    return _covered(corners, linear[faces], at, own - tolerance * scale, not view.orthographic)


@njit(cache=True, error_model="numpy")
def _covered(corners, linear, at, limits, inverse):
    found = np.zeros(len(at), np.bool_)
    for f in range(len(corners)):
        (ax, ay), (bx, by), (cx, cy) = corners[f, 0], corners[f, 1], corners[f, 2]
        area = (bx - ax) * (cy - by) - (by - ay) * (cx - bx)
        if not abs(area) > 1e-12:
            continue
        for n in range(len(at)):
            x, y = at[n]
            u = ((bx - ax) * (y - ay) - (by - ay) * (x - ax)) / area
            v = ((cx - bx) * (y - by) - (cy - by) * (x - bx)) / area
            w = ((ax - cx) * (y - cy) - (ay - cy) * (x - cx)) / area
            if u >= 0.0 and v >= 0.0 and w >= 0.0:
                mixed = v * linear[f, 0] + w * linear[f, 1] + u * linear[f, 2]
                found[n] |= (1.0 / mixed if inverse else mixed) < limits[n]
    return found


def inked(pixels):
    """(h, w) bool: where a black line is on a white picture."""
    return pixels[:, :, :3].max(axis=2) < 128
