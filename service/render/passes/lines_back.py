"""Back faces as lines: their edges, their rims, or they themselves pulled towards the eye.

Image Precision Silhouette Edges, sections 3.1 to 3.3. Where they come out nearer than, or as near as, the nearest layer, there is the
silhouette.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from schemas.lines import LineMethod, Lines, LineStyle
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
    if not len(frame.back_faces):
        return
    gpu, surface = frame.gpu, surface_of(frame)
    program = gpu.programs.get("pulled", "line")
    rows = frame.asset.shading_faces[frame.back_faces]
    if surface.indices is None:
        rows = (3 * frame.back_faces[:, None] + np.arange(3, dtype=np.int32)).astype(np.int32)
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
