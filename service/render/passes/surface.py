"""The coloured surface: the hull with its maps, or the original mesh."""

from __future__ import annotations

import moderngl
import numpy as np

from schemas.render import Antialias, ShadingMode
from service.render.gpu_cache import Surface
from service.render.passes.light import light_of
from service.render.state import LINEAR_TABLE, FrameState, parse_color

SHOW = {ShadingMode.LAMBERT: "SHOW_LAMBERT", ShadingMode.NORMAL: "SHOW_NORMAL", ShadingMode.MASK: "SHOW_FLAT"}


def draw_surface(frame: FrameState) -> None:
    """Draw the surface with depth test into colour; alpha too, unless it holds an outline already."""
    gpu, plan = frame.gpu, frame.plan
    surface = surface_of(frame)
    program = shaded_program(frame, surface, "surface")
    frame.use_target(color=True, alpha=plan.antialias is not Antialias.LINE, depth=True)
    if "stencil" in plan.passes and plan.antialias is Antialias.NONE:
        gpu.gl.keep_positive_windings()
    else:
        gpu.gl.ignore_windings()
    gpu.ctx.enable_only(moderngl.DEPTH_TEST | (moderngl.CULL_FACE if plan.closed else moderngl.NOTHING))
    gpu.ctx.front_face = frame.front_face
    gpu.gl.draw(surface.array(gpu.ctx, program))


def surface_of(frame: FrameState) -> Surface:
    """The surface that the plan draws, in the GL."""
    shading = frame.request.shading
    colored = shading.use_mesh_color and shading.mode is ShadingMode.LAMBERT
    return frame.gpu.cache.get(frame.asset, frame.plan.hull, colored=colored, halvings=frame.plan.halvings)


def shaded_program(frame: FrameState, surface: Surface, vertex: str) -> moderngl.Program:
    """The program `vertex` with the surface's shading, all uniforms and textures set."""
    shading = frame.request.shading
    definitions = {SHOW[shading.mode]} | (set() if frame.plan.closed else {"TWO_SIDED"})
    placed = {} if frame.view.normal_matrix is None else {"normal_matrix": frame.view.normal_matrix.T.astype(np.float32).tobytes()}
    program = frame.gpu.programs.get(vertex, "surface", surface.definitions | definitions | {name.upper() for name in placed})
    color = LINEAR_TABLE[list(parse_color(shading.color))].astype(np.float64)
    frame.gpu.programs.set(
        program,
        **frame.placement(),
        base_color=tuple(color.tolist()),
        base_root=tuple((color ** (1.0 / 2.4)).tolist()),
        light=light_of(frame),
        ambient=shading.ambient,
        **placed,
        **{name: unit for unit, name in enumerate(surface.textures)},
    )
    for unit, texture in enumerate(surface.textures.values()):
        texture.use(unit)
    return program
