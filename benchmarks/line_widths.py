"""Whether strokes are as wide as was asked: ink across exact silhouette edges, in pictures of real meshes.

    python -m benchmarks.line_widths MESH [MESH ...] [--views 6] [--size 512] [--widths 1.5,2.5,4,8,12,20] [--json]

Silhouettes alone on a transparent picture, 4 x 4 samples a pixel. Where they are comes from the mesh (`service.silhouette.lines`): visible
silhouette edges, their places in the image and which side is outwards. Across points of these the ink is added up, in steps of a
quarter pixel, from 3 pixels before where the stroke should begin to 3 pixels beyond where it should end: fattened ones lie outwards of the
edge (Image Precision Silhouette Edges, section 3.3), those of the edge mesh half on each side.

Points count where no other line has ink by right: the stroke's outer side is nearer to the point's own line than to any other, and
on its inner side no other line's stroke lies. *within*: percent of points whose ink is within half a pixel of the width.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.ndimage import map_coordinates
from scipy.spatial import cKDTree

from benchmarks.line_samples import pixels_at, points_along
from benchmarks.lines import loaded
from benchmarks.models import MESH_HELP, mesh_file
from benchmarks.report import Result, markdown_table
from schemas.conventions import F8, Array
from schemas.lines import LineKind, LineMethod
from schemas.render import AnyCamera, ProjectTo, RenderRequest, SilhouetteRequest
from service.assets import MeshAsset
from service.camera import resolve_camera
from service.measure.views import spread_view
from service.render.frame import render_frame
from service.render.state import Gpu
from service.silhouette.lines import KINDS, Passes, find_pieces

METHODS = (LineMethod.FATTENED, LineMethod.EDGE_MESH)
WIDTHS = (1.5, 2.5, 4.0, 8.0, 12.0, 20.0)
OFF_PX, BAR = 0.5, 95.0
"""Most that a stroke may be wider or narrower than was asked, and percent of all points that must be so."""
APART_PX, STEP_PX = 0.5, 0.25
"""Between points along a line, and between samples across it."""
BEYOND_PX = 3.0
"""How far before and beyond the stroke ink is looked for."""
SURE_PX = 0.3
"""Distances are sure to within this: points are so far apart, and edges are not quite straight where they meet."""


@dataclass(frozen=True)
class LinePoints:
    """Points along visible lines of an image. pixels (n, 2) f8, y down; outwards (n, 2) f8 unit, of silhouettes away from the face that is
    front-facing; silhouettes (n,) bool: the others are boundaries and intersections."""

    pixels: F8
    outwards: F8
    silhouettes: Array


def line_points(asset: MeshAsset, camera: AnyCamera, side: int) -> LinePoints:
    """Points APART_PX apart along all visible lines of an image side x side that are there whatever the angles between faces."""
    kinds = [LineKind.SILHOUETTE, LineKind.BOUNDARY, LineKind.INTERSECTION]
    wanted = SilhouetteRequest(camera=camera, project=ProjectTo(width=side, height=side), kinds=kinds)
    view, mesh = resolve_camera(camera, asset.frame, side, side, asset.radius), asset.line_mesh
    pieces = find_pieces(mesh, view, wanted, Passes())
    of, at = points_along(pieces, pieces.visible, APART_PX)
    line = pieces.line[of]
    directed = mesh.silhouette(view.eye).astype(np.int64) @ [1 << 32, 1]
    forwards = np.isin(pieces.segments.nodes[line].astype(np.int64) @ [1 << 32, 1], directed)
    along = pieces.image[line, 2:4] - pieces.image[line, :2]
    along *= (np.where(forwards, 1.0, -1.0) / np.linalg.norm(along, axis=1))[:, None]
    silhouettes = np.array([kind is LineKind.SILHOUETTE for kind in KINDS])[pieces.segments.kinds[line]]
    # the front face is on the left, and rows of the image run down
    return LinePoints(pixels_at(pieces, of, at), np.stack([-along[:, 1], along[:, 0]], axis=1), silhouettes)


def alone(points: LinePoints, method: LineMethod, width: float, side: int) -> Array:
    """(n,) int: rows of silhouette points across which no other line has ink by right, and whose strokes are in the image."""
    pixels, outwards = points.pixels, points.outwards
    low, high = _reach(method, width)
    rows = np.flatnonzero(points.silhouettes)
    for end in (low - BEYOND_PX - 1.0, high + BEYOND_PX + 1.0):
        at = pixels[rows] + end * outwards[rows]
        rows = rows[np.all((at > 0.0) & (at < side), axis=1)]
    tree = cKDTree(pixels)
    for beyond in np.arange(OFF_PX, BEYOND_PX + 0.5, 0.5):
        rows = rows[tree.query(pixels[rows] + (high + beyond) * outwards[rows])[0] > high + SURE_PX]
        inside = pixels[rows] + (low - beyond) * outwards[rows]
        if method is LineMethod.EDGE_MESH:
            rows = rows[tree.query(inside)[0] > high + SURE_PX]
        else:
            rows = rows[~_beside_another(points, tree, inside, width)]
    return rows


def _reach(method: LineMethod, width: float) -> tuple[float, float]:
    """Where a stroke begins and ends, pixels outwards of the edge."""
    return (-0.5 * width, 0.5 * width) if method is LineMethod.EDGE_MESH else (0.0, width)


def _beside_another(points: LinePoints, tree: cKDTree, at: F8, width: float) -> Array:
    """(n,) bool: whether a place is within a width outwards of some line, straight across it."""
    near = cKDTree(at).sparse_distance_matrix(tree, width + SURE_PX, output_type="ndarray")
    of, other = near["i"], near["j"]
    away, outwards = at[of] - points.pixels[other], points.outwards[other]
    across = np.einsum("ij,ij->i", away, outwards)
    aside = np.abs(away[:, 0] * outwards[:, 1] - away[:, 1] * outwards[:, 0])
    # of a boundary or an intersection it is not known which side is out
    beside = (aside <= APART_PX) & (np.where(points.silhouettes[other], across, np.abs(across)) > SURE_PX)
    found = np.zeros(len(at), bool)
    found[of[beside]] = True
    return found


def inked(gpu: Gpu, asset: MeshAsset, camera: AnyCamera, side: int, method: LineMethod, width: float) -> F8:
    """(side, side) f8: how much of each pixel is ink."""
    request = RenderRequest.model_validate(
        {
            "camera": camera, "width": side, "height": side, "shading": {"fill": "none"},
            "accuracy": {"source": "original", "antialias": "ssaa"},
            "lines": {"method": method, "silhouette": {"width": width}, "boundary": None},
        }
    )  # fmt: skip
    found: F8 = render_frame(gpu, asset, request).pixels[:, :, 3] / 255.0
    return found


def widths_found(ink: F8, points: LinePoints, rows: Array, method: LineMethod, width: float) -> F8:
    """(r,) f8 pixels: ink across the points of these rows."""
    low, high = _reach(method, width)
    steps = np.arange(low - BEYOND_PX, high + BEYOND_PX, STEP_PX)
    at = points.pixels[rows, None] + steps[None, :, None] * points.outwards[rows, None] - 0.5
    sampled = map_coordinates(ink, [at[:, :, 1], at[:, :, 0]], order=1)
    return np.asarray(STEP_PX * sampled.sum(axis=1))


def measure(gpu: Gpu, asset: MeshAsset, views: int, side: int, widths: tuple[float, ...] = WIDTHS) -> Result:
    """{method: [{width, points, within, worst_view, narrow, wide}]} of one mesh."""
    result: Result = {"mesh": asset.id, "faces": len(asset.faces)} | {method.value: [] for method in METHODS}
    cameras = [spread_view(view, views) for view in range(views)]
    lines = [line_points(asset, camera, side) for camera in cameras]
    for method in METHODS:
        for width in widths:
            off = []
            for camera, points in zip(cameras, lines, strict=True):
                ink = inked(gpu, asset, camera, side, method, width)
                off.append(widths_found(ink, points, alone(points, method, width, side), method, width) - width)
            result[method.value].append({"width": width} | _shares(off))
    return result


def _shares(off: list[F8]) -> dict[str, Any]:
    """Percent of all points within OFF_PX, and narrower or wider; of the worst view."""
    every, measured = np.concatenate(off), [one for one in off if len(one)]
    if not len(every):
        return {"points": 0, "within": None, "worst_view": None, "narrow": None, "wide": None}
    within = [100.0 * float((np.abs(one) <= OFF_PX).mean()) for one in (every, *measured)]
    narrow, wide = (100.0 * float(part.mean()) for part in (every < -OFF_PX, every > OFF_PX))
    shares = {"within": within[0], "worst_view": min(within[1:]), "narrow": narrow, "wide": wide}
    return {"points": len(every)} | {name: round(share, 2) for name, share in shares.items()}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("meshes", nargs="+", help=MESH_HELP)
    parser.add_argument("--views", type=int, default=6)
    parser.add_argument("--size", type=int, default=512)
    parser.add_argument("--widths", default=",".join(map(str, WIDTHS)), help="pixels, separated by commas")
    parser.add_argument("--json", action="store_true", help="one JSON object instead of a table")
    given = parser.parse_args()
    widths = tuple(float(width) for width in given.widths.split(","))
    gpu, rows = Gpu(1024), []
    try:
        for name in given.meshes:
            with mesh_file(name) as path:
                rows.append(measure(gpu, loaded(path), given.views, given.size, widths))
    finally:
        gpu.release()
    if given.json:
        print(json.dumps({"views": given.views, "size": given.size, "bar": BAR, "meshes": rows}))
        return
    cells = [
        [row["mesh"], method.value, *("–" if value is None else f"{value:g}" for value in one.values())]
        for row in rows for method in METHODS for one in row[method.value]
    ]  # fmt: skip
    print(markdown_table(["mesh", "lines", "width, px", "points", "within, %", "worst view", "narrower", "wider"], cells))


if __name__ == "__main__":
    main()
