"""The coloured surface: the hull with its maps, or the original mesh."""

from __future__ import annotations

import moderngl
import numpy as np

from schemas.conventions import F8
from schemas.render import Antialias, Fill, ShadingMode
from service.camera import View
from service.render.gpu_cache import Surface
from service.render.passes.light import light_of
from service.render.state import LINEAR_TABLE, FrameState, parse_color

WHITE = "#ffffff"
SHOW = {
    ShadingMode.LAMBERT: "SHOW_LAMBERT",
    ShadingMode.NORMAL: "SHOW_NORMAL",
    ShadingMode.MASK: "SHOW_PLAIN",
    ShadingMode.GOOCH: "SHOW_GOOCH",
    ShadingMode.FLAT: "SHOW_FACES",
    ShadingMode.DEPTH: "SHOW_DEPTH",
    ShadingMode.MATCAP: "SHOW_MATCAP",
}
COLORLESS = (ShadingMode.NORMAL, ShadingMode.MASK, ShadingMode.DEPTH)


def draw_surface(frame: FrameState) -> None:
    """Draw the surface with depth test into colour; alpha too, unless it holds an outline already. One without a fill leaves nothing of
    what is behind it."""
    gpu, plan = frame.gpu, frame.plan
    surface = surface_of(frame)
    shown = frame.request.shading.fill is not Fill.NONE
    program = shaded_program(frame, surface, "surface") if shown else _empty_program(frame)
    frame.use_target(color=True, alpha=plan.antialias is not Antialias.LINE, depth=True)
    if "stencil" in plan.passes and plan.antialias is Antialias.NONE:
        gpu.gl.keep_positive_windings()
    else:
        gpu.gl.ignore_windings()
    gpu.ctx.enable_only(moderngl.DEPTH_TEST | (moderngl.CULL_FACE if plan.closed else moderngl.NOTHING))
    gpu.ctx.front_face = frame.front_face
    gpu.gl.draw(surface.array(gpu.ctx, program))


def _nearness(view: View) -> F8:
    """(4,) f8, as `View.nearness`."""
    return np.append(view.view[2, :3], 0.0) if view.nearness is None else view.nearness


def surface_of(frame: FrameState) -> Surface:
    """The surface that the plan draws, in the GL."""
    shading = frame.request.shading
    plain = shading.mode in COLORLESS or shading.fill is not Fill.SHADED or _charcoal(frame)
    colored = shading.use_mesh_color and not plain
    return frame.gpu.cache.get(frame.asset, frame.plan.hull, colored=colored, halvings=frame.plan.halvings)


def _charcoal(frame: FrameState) -> bool:
    return frame.plan.lines is not None and frame.plan.lines.charcoal


def _empty_program(frame: FrameState) -> moderngl.Program:
    program = frame.gpu.programs.get("loops", "line")
    frame.gpu.programs.set(program, **frame.placement(), color=(0.0, 0.0, 0.0, 0.0))
    return program


def shaded_program(frame: FrameState, surface: Surface, vertex: str) -> moderngl.Program:
    """The program `vertex` with the surface's shading, all uniforms and textures set."""
    shading = frame.request.shading
    white, charcoal = shading.fill is Fill.WHITE, _charcoal(frame)
    lit = SHOW[ShadingMode.LAMBERT] if vertex == "rim" and shading.mode is ShadingMode.FLAT else SHOW[shading.mode]  # edges have no face
    show = "SHOW_PLAIN" if white else "SHOW_CHARCOAL" if charcoal else lit
    definitions = {show} | (set() if frame.plan.closed else {"TWO_SIDED"})
    placed = {} if frame.view.normal_matrix is None else {"normal_matrix": frame.view.normal_matrix.T.astype(np.float32).tobytes()}
    program = frame.gpu.programs.get(vertex, "surface", surface.definitions | definitions | {name.upper() for name in placed})
    color = LINEAR_TABLE[list(parse_color(WHITE if white else shading.color))].astype(np.float64)
    frame.gpu.programs.set(
        program,
        **frame.placement(),
        base_color=tuple(color.tolist()),
        base_root=tuple((color ** (1.0 / 2.4)).tolist()),
        light=light_of(frame),
        ambient=shading.ambient,
        eye=tuple(frame.view.eye.tolist()),
        turn=-1.0 if frame.view.mirrored else 1.0,
        nearness=tuple(_nearness(frame.view).tolist()),
        camera_axes=np.ascontiguousarray(frame.view.view[:3, :3].T, np.float32).tobytes(),
        **placed,
        **{name: unit for unit, name in enumerate(surface.textures)},
    )
    for unit, texture in enumerate(surface.textures.values()):
        texture.use(unit)
    return program
