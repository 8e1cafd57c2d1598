"""Antialiased silhouette lines in the alpha channel.

Silhouette Clipping, section 6, "Antialiasing". Departures: lines are rectangles whose coverage the shader computes, so that
no driver's line smoothing matters; a line's alpha is the area that the inside of its edge covers of the pixel (a half on the
edge), where a smooth GL line has one on the edge and makes the shape half a pixel larger all round; where lines meet the
larger alpha stays, whatever the order.
"""

from __future__ import annotations

import moderngl
import numpy as np

from service.render.state import FrameState


def draw_outline(frame: FrameState) -> None:
    """Draw the segments into alpha."""
    if not len(frame.segments):
        return
    gpu, tile = frame.gpu, frame.tile
    frame.use_target(color=False, alpha=True, depth=False)
    gpu.gl.ignore_windings()
    gpu.ctx.enable_only(moderngl.BLEND)
    gpu.ctx.blend_func = moderngl.ONE, moderngl.ONE
    gpu.ctx.blend_equation = moderngl.MAX, moderngl.MAX
    program = gpu.programs.get("outline", "outline")
    gpu.programs.set(program, origin=(float(tile.x), float(tile.y)), pixel=frame.pixel())
    lines = gpu.streamed(program, frame.segments.astype(np.float32), "4f/i", ["in_segment"])
    gpu.gl.draw(lines, moderngl.TRIANGLE_STRIP, vertices=4, instances=len(frame.segments))
    gpu.ctx.blend_equation = moderngl.FUNC_ADD, moderngl.FUNC_ADD
