"""Antialiased silhouette lines in the alpha channel.

Silhouette Clipping, section 6, "Antialiasing". Departures: lines are rectangles whose coverage the shader computes, so that
no driver's line smoothing matters; a line's alpha is the area that the inside of its edge covers of the pixel (a half on the
edge), where a smooth GL line has one on the edge and makes the shape half a pixel larger all round. Lines smooth both sides: where
nothing is, the larger alpha stays, and just inside, where the winding number is one, the smaller, whatever the order. Where it is more,
another layer lies behind the edge, and alpha is whole.
"""

from __future__ import annotations

import moderngl
import numpy as np

from service.render.state import FrameState


def draw_outline(frame: FrameState) -> None:
    """Draw the segments into alpha, which holds the interior."""
    if not len(frame.segments):
        return
    gpu, tile = frame.gpu, frame.tile
    frame.use_target(color=False, alpha=True, depth=False)
    gpu.ctx.enable_only(moderngl.BLEND)
    gpu.ctx.blend_func = moderngl.ONE, moderngl.ONE
    segments = frame.segments.astype(np.float32)
    for side in ("outside", "inside"):
        inside = side == "inside"
        gpu.ctx.blend_equation = (moderngl.MIN, moderngl.MIN) if inside else (moderngl.MAX, moderngl.MAX)
        program = gpu.programs.get("outline", "outline", frozenset({"INSIDE"} if inside else ()))
        gpu.programs.set(program, origin=(float(tile.x), float(tile.y)), pixel=frame.pixel())
        if inside:
            gpu.gl.keep_single_windings()
        else:
            gpu.gl.keep_no_windings()
        lines = gpu.streamed(program, segments, "4f/i", ["in_segment"])
        gpu.gl.draw(lines, moderngl.TRIANGLE_STRIP, vertices=4, instances=len(segments))
    gpu.ctx.blend_equation = moderngl.FUNC_ADD, moderngl.FUNC_ADD
