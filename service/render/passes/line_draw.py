"""How lines get into the picture, whichever they are: opaque, or blended so that those that overlap count once."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import moderngl

from schemas.lines import LineStyle
from service.render.state import LINEAR_TABLE, FrameState, Strokes, parse_color

Draw = Callable[[dict[str, Any]], None]
"""Draws with the uniform `color` as given."""


def draw_strokes(frame: FrameState, strokes: Strokes) -> None:
    """Draw strokes over what is there and not nearer."""
    if not len(strokes.indices):
        return
    gpu, tile = frame.gpu, frame.tile
    program = gpu.programs.get("line", "line")
    array = gpu.streamed(program, strokes.corners, "3f", ["in_corner"], strokes.indices)
    origin = (float(tile.x), float(tile.y))

    def draw(look: dict[str, Any]) -> None:
        gpu.programs.set(program, origin=origin, pixel=frame.pixel(), range=gpu.gl.deep_range, **look)
        gpu.gl.draw(array)

    draw_in_style(frame, strokes.style, draw)


def draw_in_style(frame: FrameState, style: LineStyle, draw: Draw) -> None:
    """Draw opaque, or blended in linear light, every sample once (the stencil knows which have been)."""
    gpu, red_green_blue = frame.gpu, parse_color(style.color)
    gpu.ctx.depth_func = ">="
    if style.opacity == 1.0:
        gpu.gl.ignore_windings()
        gpu.ctx.enable_only(moderngl.DEPTH_TEST)
        frame.use_target(color=True, alpha=True, depth=True)
        draw({"color": (*(byte / 255.0 for byte in red_green_blue), 1.0)})
    elif style.opacity > 0.0:
        frame.marked += 1
        gpu.gl.mark_once(frame.marked)
        gpu.ctx.enable_only(moderngl.DEPTH_TEST | moderngl.BLEND)
        gpu.ctx.blend_func = moderngl.ONE, moderngl.ONE_MINUS_SRC_ALPHA
        frame.use_target(color=True, alpha=True, depth=False)
        gpu.gl.blend_in_linear_light(True)
        linear = LINEAR_TABLE[list(red_green_blue)] * style.opacity
        draw({"color": (*map(float, linear), style.opacity)})
        gpu.gl.blend_in_linear_light(False)
        gpu.gl.ignore_windings()
    gpu.ctx.depth_func = ">"
