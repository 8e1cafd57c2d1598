"""Whether vector lines are hidden where the GL's depth buffer says so.

    python -m benchmarks.line_depths MESH [MESH ...] [--views 20] [--size 2048] [--json]

The mesh is drawn by the GL, reversed floats of depth alone; rays and cuts of `service.silhouette.lines` have no part in that. Points two
pixels apart along silhouettes and boundaries, visible and hidden, are held against it: hidden where the surface is nearer at all four
pixel centres about the point. *agree*: percent of the points that the buffer is *sure* of. Those are not whose surface before them is
nearer by less than a pixel's size at some of the four, nor visible ones within 1.5 pixels of hidden ones, or the other way round.
"""

from __future__ import annotations

import argparse
import json

import moderngl
import numpy as np
from scipy.spatial import cKDTree

from benchmarks.line_samples import pixels_at, points_along
from benchmarks.lines import loaded
from benchmarks.models import MESH_HELP, mesh_file
from benchmarks.report import Result, markdown_table
from schemas.conventions import F4, F8, Array
from schemas.lines import LineKind
from schemas.render import AnyCamera, ProjectTo, RenderRequest, SilhouetteRequest
from service.assets import MeshAsset
from service.camera import View, resolve_camera
from service.kernels.line_image import NEAR0, NEAR1
from service.measure.views import spread_view
from service.render.deep import NEAREST_PART, pixel_depth
from service.render.plan import plan_frame
from service.render.state import FrameState, Gpu
from service.render.targets import Kind
from service.silhouette.lines import Passes, Pieces, find_pieces
from service.tile import Tile

APART_PX, BAR = 2.0, 99.0
"""Between points, and percent that must agree."""
LEAST_PART = 2e-6
"""Of a depth: what floats of it are good to, with the matrix that it comes from."""
MOST_PX = 1.0
"""Pixels' sizes nearer: what is before a point by more hides it for sure."""
NEAR_PX = 1.5
"""A centre of a pixel may lie beyond the outline that hides a point, where that is nearer than this."""


def depth_buffer(gpu: Gpu, asset: MeshAsset, camera: AnyCamera, side: int) -> F4:
    """(side, side) f4 reversed depth (`service.render.deep`), row 0 at the top; 0 where there is nothing."""
    fields = {"accuracy": {"source": "original", "antialias": "none"}, "lines": {"method": "wireframe"}}
    request = RenderRequest.model_validate({"camera": camera, "width": side, "height": side} | fields)
    view = resolve_camera(camera, asset.frame, side, side, asset.radius)
    whole = Tile(0, 0, side, side)
    frame = FrameState(gpu, asset, request, plan_frame(request, asset, view, gpu.costs), view, None, area=whole, tile=whole)
    target = gpu.targets.get(side, side, kind=Kind.NUMBERS)
    target.framebuffer.viewport = (0, 0, side, side)
    target.framebuffer.use()
    program = gpu.programs.get("loops", "number")
    gpu.ctx.enable_only(moderngl.DEPTH_TEST)
    gpu.gl.ignore_windings()
    gpu.gl.reverse_depth(True)
    gpu.gl.clear_numbers()
    gpu.programs.set(program, **frame.placement())
    gpu.gl.draw(gpu.cache.get(asset, None, colored=False).array(gpu.ctx, program))
    read = target.framebuffer.read(viewport=(0, 0, side, side), components=1, attachment=-1, dtype="f4")
    gpu.gl.reverse_depth(False)
    gpu.gl.check()

    return np.frombuffer(read, np.float32).reshape(side, side)


def own_depths(view: View, pieces: Pieces, piece: Array, part: F8) -> F8:
    """(n,) f8: the same depth of places on lines."""
    near = pieces.image[pieces.line[piece]]
    nearness = near[:, NEAR0] + part * (near[:, NEAR1] - near[:, NEAR0])
    if view.orthographic:
        return np.asarray((nearness + view.far) / (view.far - view.near))
    return np.asarray(nearness * view.far * NEAREST_PART)


def lines_of(asset: MeshAsset, camera: AnyCamera, side: int) -> tuple[Pieces, View]:
    """Silhouettes and boundaries in an image side x side, and its view."""
    kinds = [LineKind.SILHOUETTE, LineKind.BOUNDARY]
    wanted = SilhouetteRequest(camera=camera, project=ProjectTo(width=side, height=side), kinds=kinds, contours=False)
    view = resolve_camera(camera, asset.frame, side, side, asset.radius)
    return find_pieces(asset.line_mesh, view, wanted, Passes()), view


def compared(pieces: Pieces, view: View, buffer: F4) -> tuple[int, int, int, int]:
    """(points, those that the buffer is sure of, those of them that agree, hidden ones of them)."""
    piece, part = points_along(pieces, np.ones(len(pieces.line), bool), APART_PX)
    visible = pieces.visible[piece]
    pixels, own = pixels_at(pieces, piece, part), own_depths(view, pieces, piece, part)
    column, row = (np.clip(np.floor(pixels[:, k] - 0.5).astype(int), 0, len(buffer) - 2) for k in range(2))
    farthest = np.min([buffer[row + i, column + j] for i in range(2) for j in range(2)], axis=0).astype(np.float64)
    share, shift = pixel_depth(view)
    before = farthest > own * (1.0 + LEAST_PART) + (LEAST_PART if view.orthographic else 0.0)
    well_before = farthest > own * (1.0 + MOST_PX * share) + MOST_PX * shift
    sure = (before == well_before) & ~_near_others(pixels, visible)
    return len(piece), int(sure.sum()), int((sure & (well_before != visible)).sum()), int((sure & ~visible).sum())


def _near_others(pixels: F8, visible: Array) -> Array:
    """(n,) bool: visible points within NEAR_PX of hidden ones, and hidden ones so near to visible ones."""
    near = np.zeros(len(pixels), bool)
    if visible.any() and not visible.all():
        for which in (visible, ~visible):
            near[which] = cKDTree(pixels[~which]).query(pixels[which])[0] < NEAR_PX
    return near


def measure(gpu: Gpu, asset: MeshAsset, views: int, side: int) -> Result:
    """{points, sure, hidden, agree, worst_view} of one mesh, percent but for the points."""
    cameras = [spread_view(view, views) for view in range(views)]
    counts = np.array([compared(*lines_of(asset, camera, side), depth_buffer(gpu, asset, camera, side)) for camera in cameras])
    points, sure, agree, hidden = counts.sum(axis=0).tolist()
    seen = counts[counts[:, 1] > 0]
    return {
        "mesh": asset.id,
        "faces": len(asset.faces),
        "points": points,
        "sure": round(100.0 * sure / max(points, 1), 2),
        "hidden": round(100.0 * hidden / max(sure, 1), 2),
        "agree": round(100.0 * agree / max(sure, 1), 3),
        "worst_view": round(100.0 * float((seen[:, 2] / seen[:, 1]).min(initial=1.0)), 3),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("meshes", nargs="+", help=MESH_HELP)
    parser.add_argument("--views", type=int, default=20)
    parser.add_argument("--size", type=int, default=2048, help="pixels along each side")
    parser.add_argument("--json", action="store_true", help="one JSON object instead of a table")
    given = parser.parse_args()
    gpu, rows = Gpu(1024), []
    try:
        for name in given.meshes:
            with mesh_file(name) as path:
                rows.append(measure(gpu, loaded(path), given.views, given.size))
    finally:
        gpu.release()
    if given.json:
        print(json.dumps({"views": given.views, "size": given.size, "bar": BAR, "meshes": rows}))
        return
    cells = [[row["mesh"], *(f"{row[key]:,}" for key in ("faces", "points", "sure", "hidden", "agree", "worst_view"))] for row in rows]
    print(markdown_table(["mesh", "faces", "points", "sure, %", "hidden, %", "agree, %", "worst view, %"], cells))


if __name__ == "__main__":
    main()
