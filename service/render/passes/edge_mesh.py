"""Lines over the picture from the edge mesh: silhouettes, borders, ridges and valleys.

Based on: Fast Silhouettes, "Rendering Implementation": an edge is a silhouette where its faces look to different sides of the eye, and a
ridge or valley by the angle between them. Departures:

- The article moves vertices along the faces' normals, by an amount that grows with the distance so that widths stay alike, and hides
  what is not a line by its alpha. Here a line is a rectangle on the screen of exactly the width that is asked for, and what is not a line
  makes no triangle. Its ends are round, so that chains of edges have no gaps.
- Half of such a rectangle lies over the faces beside the edge, which are often nearer than the edge. Instead of a depth test of each
  pixel with some bias, all pixels of a line are hidden where the nearest point of its edge is: widths do not suffer, and a line
  behind a surface does not show through it by the bias.
- Edges of two back faces are left out where no back face can be seen.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import moderngl
import numpy as np

from schemas.lines import Lines, LineStyle
from service.camera import View
from service.render.deep import NEAREST_PART as FARTHEST_DEPTH
from service.render.deep import pixel_depth
from service.render.edge_mesh import EdgeMesh
from service.render.line_plan import reference_depth, styles_of
from service.render.state import LINEAR_TABLE, FrameState, parse_color

NEAREST_PART = 1e-3
"""Parts of an edge that are nearer than this part of the view's near depth are cut off."""
WIDEST = 8.0
"""Lines whose width follows the distance are at most so many times as wide as in the middle of the mesh."""
USUAL_RANGE = 2.0, -1.0
"""(scale, shift) from window depth to the clip coordinate, as `GlContext.deep_range` where depth is reversed."""
LEAST_WIDTH = 1.0
"""Target pixels: thinner lines would have gaps wherever they pass between pixel centres."""

KINDS = 4
Styles = Sequence[LineStyle | None]
"""Of silhouettes, borders, ridges and valleys; None for those that are not drawn. The first of several that an edge is counts."""


def draw_edge_mesh(frame: FrameState) -> None:
    """Draw the lines of the plan over the surface in the target, whose depth says which are hidden.

    Raises RuntimeError when there is no target.
    """
    lines = frame.plan.lines
    assert lines is not None
    draw_lines_of(frame, frame.gpu.cache.edge_mesh(frame.asset), lines)


def draw_lines_of(frame: FrameState, mesh: EdgeMesh, lines: Lines) -> None:
    """The same for an edge mesh that the cache does not have, such as one that has been moved."""
    if frame.target is None:
        raise RuntimeError("lines came before the surface they are drawn over")
    gpu, target, styles = frame.gpu, frame.target, _styles(lines, mesh)
    framebuffer = gpu.targets.over(target)
    framebuffer.viewport = (0, 0, frame.tile.width * frame.scale, frame.tile.height * frame.scale)
    _write(framebuffer, color=False, alpha=False, depth=True)
    if frame.line_place[0] == 0:
        framebuffer.clear()
    if not any(styles):
        return
    program = _program(frame, mesh, lines, styles)
    gpu.programs.set(program, **frame.placement(), **_geometry(frame, lines, styles), depth=0, positions=1)
    gpu.gl.use_depth_texture(target.depth, target.samples, 0)
    mesh.positions.use(1)
    gpu.gl.ignore_windings()
    # where lines meet the first one stays, those of an earlier kind are before those of a later one, and those of a later mesh before all
    gpu.gl.reverse_depth(False)
    if all(style is None or style.opacity == 1.0 for style in styles):
        _draw_opaque(frame, mesh, program, styles)
    else:
        _draw_translucent(frame, mesh, program, styles)
    gpu.gl.reverse_depth(frame.plan.deep)


def reach_of(lines: Lines, view: View) -> int:
    """Pixels from an edge, at most, to what its line covers: as far away depth is asked for."""
    half_width = max((0.5 * style.width for style in styles_of(lines)), default=0.0)
    return math.ceil(half_width * _most_widened(lines, view)) + 1


def _most_widened(lines: Lines, view: View) -> float:
    """What the nearest lines are wider by than is asked for."""
    return min(WIDEST, max(1.0, reference_depth(view) / view.near)) if _follows(lines, view) else 1.0


def _follows(lines: Lines, view: View) -> bool:
    """Whether widths follow the distance."""
    return lines.scale == "distance" and not view.orthographic


def _draw_opaque(frame: FrameState, mesh: EdgeMesh, program: moderngl.Program, styles: Styles) -> None:
    """All kinds at once, in the bytes of their colours."""
    gpu = frame.gpu
    gpu.programs.set(program, only=-1, colors=[_color(style, linear=False) for style in styles])
    _write(gpu.ctx.fbo, color=True, alpha=True, depth=True)
    gpu.ctx.enable_only(moderngl.DEPTH_TEST)
    gpu.gl.draw(mesh.array(program), moderngl.POINTS, vertices=mesh.count)


def _draw_translucent(frame: FrameState, mesh: EdgeMesh, program: moderngl.Program, styles: Styles) -> None:
    """Each kind by itself, those before others first, so that no pixel is blended twice.

    Samples are averaged as premultiplied, so blending over nothing leaves them so. Pixels that are not averaged keep straight alpha: where
    there is nothing yet, the whole colour is laid down first.
    """
    gpu, framebuffer = frame.gpu, frame.gpu.ctx.fbo
    context: Any = gpu.ctx  # its stubs know no blending of alpha by itself
    straight = "resolve" not in frame.plan.passes
    gpu.programs.set(program, colors=[_color(style, linear=True) for style in styles])
    gpu.ctx.enable_only(moderngl.DEPTH_TEST | moderngl.BLEND)
    gpu.gl.blend_in_linear_light(True)
    for kind, style in enumerate(styles):
        if style is None:
            continue
        gpu.programs.set(program, only=kind)
        if straight:
            _write(framebuffer, color=True, alpha=False, depth=False)
            context.blend_func = moderngl.ONE_MINUS_DST_ALPHA, moderngl.DST_ALPHA
            gpu.gl.draw(mesh.array(program), moderngl.POINTS, vertices=mesh.count)
        _write(framebuffer, color=True, alpha=True, depth=True)
        context.blend_func = moderngl.SRC_ALPHA, moderngl.ONE_MINUS_SRC_ALPHA, moderngl.ONE, moderngl.ONE_MINUS_SRC_ALPHA
        gpu.gl.draw(mesh.array(program), moderngl.POINTS, vertices=mesh.count)
    gpu.gl.blend_in_linear_light(False)


def _write(framebuffer: moderngl.Framebuffer, *, color: bool, alpha: bool, depth: bool) -> None:
    framebuffer.color_mask = (color, color, color, alpha)
    framebuffer.depth_mask = depth
    framebuffer.use()


def _styles(lines: Lines, mesh: EdgeMesh) -> Styles:
    """What is drawn, without what nobody would see or the mesh does not have."""
    asked = (lines.silhouette, lines.boundary if mesh.borders else None, lines.ridge, lines.valley)
    return [None if style is None or style.opacity == 0.0 or not mesh.count else style for style in asked]


def _color(style: LineStyle | None, *, linear: bool) -> tuple[float, ...]:
    if style is None:
        return 0.0, 0.0, 0.0, 0.0
    color = parse_color(style.color)
    return (*(float(LINEAR_TABLE[c]) if linear else c / 255.0 for c in color), style.opacity)


def _program(frame: FrameState, mesh: EdgeMesh, lines: Lines, styles: Styles) -> moderngl.Program:
    """The variant that does what the lines, the mesh and the target need."""
    definitions = {"BORDERS"} if mesh.borders else set()
    if frame.plan.closed:
        definitions.add("BACKS_HIDDEN")
    elif lines.orientation == "any":
        definitions.add("EITHER_SIDE")
    if styles[2] or styles[3]:
        definitions |= {"CREASES"} | ({"MOVED"} if mesh.moved else set())
    if frame.target is not None and frame.target.samples:
        definitions |= {"MULTISAMPLED", f"SAMPLES {frame.target.samples}"}
    return frame.gpu.programs.get("edge_mesh", "edge_mesh", frozenset(definitions), geometry="edge_mesh")


def _geometry(frame: FrameState, lines: Lines, styles: Styles) -> dict[str, Any]:
    """Uniforms that say where lines are and how wide."""
    view, scale = frame.view, frame.scale
    size = frame.tile.width * scale, frame.tile.height * scale
    half_widths = [0.0 if style is None else 0.5 * max(style.width * scale, LEAST_WIDTH) for style in styles]
    beyond = max(half_widths) * _most_widened(lines, view) + 1.0
    return {
        "eye": _eye(frame),
        "size": (float(size[0]), float(size[1])),
        "reach": (1.0 + 2.0 * beyond / size[0], 1.0 + 2.0 * beyond / size[1]),
        "depths": _line_depths(*frame.line_place),
        "half_widths": tuple(half_widths),
        "least_half_width": 0.5 * LEAST_WIDTH,
        "width_at": reference_depth(view) if _follows(lines, view) else 0.0,
        "widest": WIDEST,
        "least_w": 0.5 if view.orthographic else NEAREST_PART * view.near,
        "range": frame.gpu.gl.deep_range if frame.plan.deep else USUAL_RANGE,
        "farther": -1.0 if frame.plan.deep else 1.0,
        "pixel_depth": (_deep_pixel_depth(view) if frame.plan.deep else _pixel_depth(view)) / scale,
        "pixel_depth_at": 1.0 if view.orthographic else view.far,
        "ridge_deg": lines.ridge_deg,
        "valley_deg": lines.valley_deg,
    }


def _line_depths(place: int, meshes: int) -> tuple[float, float]:
    """(first, step) of the clip coordinates of the kinds, for one of so many meshes, of which the last is the nearest."""
    return -0.5 + (meshes - 1 - place) / meshes, 1.0 / (KINDS * meshes)


def _eye(frame: FrameState) -> tuple[float, ...]:
    """The eye less the `middle` of the placement, homogeneous, scaled so that no product of it overflows."""
    placement, eye = frame.placement(), frame.view.eye
    middle = np.add(placement["middle"], placement["middle_rest"])
    from_middle = np.append(eye[:3] - eye[3] * middle, eye[3])
    return tuple((from_middle / max(1.0, float(np.abs(eye).max()))).tolist())


def _pixel_depth(view: View) -> float:
    """What the size of an image pixel is in window depth, at most all of it: anywhere when orthographic, else at the far depth."""
    z, w = view.matrix[2], view.matrix[3]
    if view.orthographic:
        return min(1.0, pixel_depth(view)[1])
    # z is some A w + B, so window depth changes by B / (2 w^2) a unit, and a pixel is w / pixel_scale units
    constant = float(z[3] - (z[:3] @ w[:3]) / (w[:3] @ w[:3]) * w[3])
    return min(1.0, 0.5 * abs(constant) / (view.far * view.depth_pixels))


def _deep_pixel_depth(view: View) -> float:
    """The same where depth is reversed (`service.render.deep`)."""
    share, shift = pixel_depth(view)
    return min(1.0, shift if view.orthographic else FARTHEST_DEPTH * share)
