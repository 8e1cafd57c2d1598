"""Whether lines in pictures are the exact visible silhouette: rendered pixels held against vector lines, both ways.

    python -m benchmarks.line_pixels MESH [MESH ...] [--views 20] [--size 512] [--json]

Each method draws silhouettes and boundaries, 1.5 px wide, over white with 4 x 4 samples; vector lines are found in space and told hidden
or not by rays (`service.silhouette.lines`). *explained*: pixels with ink that are within a pixel of such a line, its width beside it.
*found*: points every half pixel along visible lines that have ink as near. Percent, the worst view beside the mean of all.

Translated back faces have no width of their own: their lines are as wide as the faces that come before the surface, 5 pixels and more of
coarse meshes, less than a tenth of one of fine ones. So of them ink is explained within 8 pixels, and any ink counts.
"""

from __future__ import annotations

import argparse
import json
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from benchmarks.lines import loaded
from benchmarks.models import MESH_HELP, mesh_file
from benchmarks.report import Result, markdown_table
from schemas.conventions import F8, Array
from schemas.lines import LineKind, LineMethod, LineStyle
from schemas.render import RenderRequest, SilhouetteRequest
from service.assets import MeshAsset
from service.measure.views import spread_view
from service.render.frame import render_frame
from service.render.state import Gpu
from service.silhouette.describe import describe_silhouette

WIDTH_PX, NEAR_PX, STEP_PX = 1.5, 1.0, 0.5
INKED = 230
"""Of a pixel that a tenth of a line covers at least: a surface that rises steeply hides the inner half of some."""
PULLED_PX, PULLED_INKED = 8.0, 255
"""Of translated faces: how far from its silhouette such a line reaches, and what is ink."""
BAR = 99.5


def visible_points(asset: MeshAsset, view: int, views: int, side: int) -> F8:
    """(n, 2) f8 pixels, y down: points along the visible silhouettes and boundaries, inside the image."""
    kinds = [LineKind.SILHOUETTE, LineKind.BOUNDARY]
    project = {"width": side, "height": side}
    request = SilhouetteRequest.model_validate(
        {"camera": spread_view(view, views), "kinds": kinds, "visible_only": True, "project": project, "contours": False}
    )
    lines = describe_silhouette(asset, request).lines
    assert lines is not None
    parts = []
    for points, closed in zip(lines.polylines(), lines.closed.tolist(), strict=True):
        ends = np.concatenate([points, points[:1]]) if closed else points
        along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(ends, axis=0), axis=1))])
        at = np.linspace(0.0, along[-1], int(along[-1] / STEP_PX) + 2)
        parts.append(np.stack([np.interp(at, along, ends[:, k]) for k in range(2)], axis=1))
    found = np.concatenate(parts) if parts else np.empty((0, 2))
    return found[np.all((found > 1.0) & (found < side - 1.0), axis=1)]


def inked_pixels(gpu: Gpu, asset: MeshAsset, method: LineMethod, view: int, views: int, side: int) -> F8:
    """(n, 2) f8: centres of the pixels that a method puts ink into."""
    style = LineStyle(width=WIDTH_PX)
    lines: dict[str, Any] = {"method": method, "silhouette": style, "boundary": style}
    request = RenderRequest.model_validate(
        {
            "camera": spread_view(view, views), "width": side, "height": side, "background": "#ffffff", "lines": lines,
            "shading": {"fill": "white"}, "accuracy": {"source": "original", "antialias": "ssaa"},
        }
    )  # fmt: skip
    inked: Array = render_frame(gpu, asset, request).pixels[:, :, 0] < (PULLED_INKED if method is LineMethod.TRANSLATED else INKED)
    rows, columns = np.nonzero(inked)
    return np.stack([columns, rows], axis=1) + 0.5


def compared(inked: F8, points: F8, reach_px: float = NEAR_PX + WIDTH_PX) -> tuple[float, float]:
    """(explained, found), percent. reach_px: how far from a line its ink may be."""
    if not len(inked) or not len(points):
        return (100.0, 100.0) if len(inked) == len(points) else (0.0, 0.0)
    near = NEAR_PX + WIDTH_PX
    explained = cKDTree(points).query(inked)[0] <= reach_px
    found = cKDTree(inked).query(points)[0] <= near
    return 100.0 * float(explained.mean()), 100.0 * float(found.mean())


def measure(gpu: Gpu, name: str, views: int, side: int) -> Result:
    """{method: {explained, found, and the worst views'}} of one mesh."""
    with mesh_file(name) as path:
        asset = loaded(path)
    shares: dict[str, list[tuple[float, float]]] = {method.value: [] for method in LineMethod}
    for view in range(views):
        points = visible_points(asset, view, views, side)
        for method, found in shares.items():
            reach_px = PULLED_PX if method == LineMethod.TRANSLATED else NEAR_PX + WIDTH_PX
            found.append(compared(inked_pixels(gpu, asset, LineMethod(method), view, views, side), points, reach_px))
    result: Result = {"mesh": asset.id, "faces": len(asset.faces)}
    for method, found in shares.items():
        mean, worst = np.mean(found, axis=0).round(3).tolist(), np.min(found, axis=0).round(3).tolist()
        result[method] = {"explained": mean[0], "found": mean[1], "worst_explained": worst[0], "worst_found": worst[1]}
    return result


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("meshes", nargs="+", help=MESH_HELP)
    parser.add_argument("--views", type=int, default=20)
    parser.add_argument("--size", type=int, default=512)
    parser.add_argument("--json", action="store_true", help="one JSON object instead of a table")
    given = parser.parse_args()
    gpu = Gpu(1024)
    try:
        rows = [measure(gpu, name, given.views, given.size) for name in given.meshes]
    finally:
        gpu.release()
    if given.json:
        print(json.dumps({"views": given.views, "size": given.size, "bar": BAR, "meshes": rows}))
        return
    cells = []
    for row in rows:
        for method in (key for key in row if key not in ("mesh", "faces")):
            one = row[method]
            cells.append([row["mesh"], method, *(f"{one[key]:.2f}" for key in ("explained", "worst_explained", "found", "worst_found"))])
    print(markdown_table(["mesh", "lines", "explained, %", "worst view", "found, %", "worst view"], cells))


if __name__ == "__main__":
    main()
