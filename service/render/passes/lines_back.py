"""Back faces as lines: their edges, their rims, or they themselves pulled towards the eye.

Image Precision Silhouette Edges, sections 3.1 to 3.3. Where they come out nearer than, or as near as, the nearest layer, there is the
silhouette.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from schemas.conventions import I4
from schemas.lines import LineMethod, Lines, LineStyle
from service.kernels.sampled_faces import place_vertices, sampled_faces
from service.render.passes.line_draw import draw_in_style, draw_strokes
from service.render.passes.line_strokes import DEFAULT_PULL, pull_of
from service.render.passes.surface import surface_of
from service.render.state import FrameState

POLYGON_OFFSET_FILL = 0x8037


def draw_lines_back(frame: FrameState) -> None:
    """Draw the silhouette's lines by the method that was asked for."""
    lines = frame.plan.lines
    if lines is None or lines.silhouette is None:
        return
    if lines.method is LineMethod.TRANSLATED:
        _draw_pulled(frame, lines, lines.silhouette)
    else:
        for strokes in frame.strokes["lines_back"]:
            draw_strokes(frame, strokes)


def _draw_pulled(frame: FrameState, lines: Lines, style: LineStyle) -> None:
    chosen = _sampled(frame)
    if not len(chosen):
        return
    gpu, surface = frame.gpu, surface_of(frame)
    program = gpu.programs.get("pulled", "line")
    rows = frame.asset.shading_faces[chosen]
    if surface.indices is None:
        rows = (3 * chosen[:, None] + np.arange(3, dtype=np.int32)).astype(np.int32)
    array = surface.some_faces(gpu.gl, program, np.ascontiguousarray(rows, np.int32))
    by_slope = lines.pull.by == "offset"

    def draw(look: dict[str, Any]) -> None:
        gpu.programs.set(program, **frame.placement(), range=gpu.gl.deep_range, pull=pull_by, **look)
        gpu.gl.draw(array)

    share, shift, by = pull_of(frame, lines)
    pull_by = (share, shift, by)
    if by_slope:
        gpu.ctx.enable_direct(POLYGON_OFFSET_FILL)
        amount = lines.pull.amount or DEFAULT_PULL["offset"]
        gpu.ctx.polygon_offset = (amount, 1.0)
    draw_in_style(frame, style, draw)
    if by_slope:
        gpu.ctx.polygon_offset = (0.0, 0.0)
        gpu.ctx.disable_direct(POLYGON_OFFSET_FILL)


def _sampled(frame: FrameState) -> I4:
    """(n,) i4: those of the faces behind that can be seen in the tile; all of them where pixels have more samples."""
    tile, scale, asset = frame.tile, float(frame.scale), frame.asset
    if frame.target is None or frame.target.samples:
        return frame.back_faces
    matrix = frame.view.pixels.copy()
    matrix[0] = scale * (matrix[0] - tile.x * matrix[3])
    matrix[1] = scale * (matrix[1] - tile.y * matrix[3])
    placed = frame.gpu.scratch.array("placed", (2, len(asset.positions)), np.float32)
    place_vertices(matrix, asset.positions, placed)
    size, kept = np.array([scale * tile.width, scale * tile.height], np.float32), np.empty_like(frame.back_faces)
    return kept[: sampled_faces(placed, size, asset.faces, frame.back_faces, kept)]
