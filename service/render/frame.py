"""A frame: which passes there are, in which order, and where in the image."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

import moderngl

from backend.tracing import span
from schemas.conventions import U1
from schemas.render import RenderRequest, ShadingMode
from service.assets import MeshAsset
from service.camera import View, resolve_camera
from service.render.bands import draw_in_bands
from service.render.context import NO_WORK, GlWork
from service.render.passes.background import make_background
from service.render.passes.charcoal import draw_charcoal
from service.render.passes.clear import clear_target
from service.render.passes.composite import compose
from service.render.passes.coverage import make_coverage
from service.render.passes.deform import deform_mesh
from service.render.passes.edge_mesh import draw_edge_mesh
from service.render.passes.edges import find_edges
from service.render.passes.first_layer import find_first_layer
from service.render.passes.hull import place_hull
from service.render.passes.interior import fill_interior
from service.render.passes.line_edges import draw_line_edges
from service.render.passes.line_faces import find_line_faces
from service.render.passes.line_strokes import make_line_strokes
from service.render.passes.lines_back import draw_lines_back
from service.render.passes.loops import make_loops
from service.render.passes.outline import draw_outline
from service.render.passes.read import read_pixels
from service.render.passes.resolve import resolve_samples
from service.render.passes.rim import draw_rim
from service.render.passes.segments import project_segments
from service.render.passes.smooth import smooth_outline
from service.render.passes.stencil import count_windings
from service.render.passes.strokes import draw_vector_strokes
from service.render.passes.surface import draw_surface
from service.render.passes.vector_lines import find_vector_lines
from service.render.plan import Plan, plan_frame
from service.render.state import FrameState, Gpu, parse_color
from service.silhouette.levels import LevelInView
from service.tile import Tile

WORTH_FLUSHING = 30_000
"""Faces from which on it pays to let the GL begin with them early: that has a price of its own."""

Make = Callable[[FrameState], None]


@dataclass(frozen=True)
class Pass:
    """A step of a frame. each_tile: once for every tile; otherwise once for the image. draws: by the GL. meanwhile: once for the image,
    but in the first tile, while the GL draws what came before."""

    name: str
    make: Make
    each_tile: bool = False
    draws: bool = False
    meanwhile: bool = False


FRAME = (
    Pass("background", make_background),
    Pass("edges", find_edges),
    Pass("loops", make_loops),
    Pass("segments", project_segments),
    Pass("smooth", smooth_outline),
    Pass("hull", place_hull),
    Pass("deform", deform_mesh, draws=True),
    Pass("first_layer", find_first_layer, draws=True),
    Pass("clear", clear_target, each_tile=True, draws=True),
    Pass("stencil", count_windings, each_tile=True, draws=True),
    Pass("surface", draw_surface, each_tile=True, draws=True),
    Pass("line_faces", find_line_faces, each_tile=True, meanwhile=True),
    Pass("vector_lines", find_vector_lines, each_tile=True, meanwhile=True),
    Pass("line_strokes", make_line_strokes, each_tile=True, meanwhile=True),
    Pass("charcoal", draw_charcoal, each_tile=True, draws=True),
    Pass("lines_back", draw_lines_back, each_tile=True, draws=True),
    Pass("line_edges", draw_line_edges, each_tile=True, draws=True),
    Pass("edge_mesh", draw_edge_mesh, each_tile=True, draws=True),
    Pass("strokes", draw_vector_strokes, each_tile=True, draws=True),
    Pass("rim", draw_rim, each_tile=True, draws=True),
    Pass("interior", fill_interior, each_tile=True, draws=True),
    Pass("outline", draw_outline, each_tile=True, draws=True),
    Pass("coverage", make_coverage, each_tile=True),
    Pass("resolve", resolve_samples, each_tile=True, draws=True),
    Pass("read", read_pixels, each_tile=True),
    Pass("composite", compose, each_tile=True),
)
"""Everything a frame can do, in order; a plan says which of it one frame does."""

TILE_SAMPLES = 2048
"""Samples along a side of a tile: bounds the GL's memory whatever the size of the image."""


class Timed:
    """Runs passes and keeps what each took, milliseconds, in order.

    true_times: of passes that draw, what the GL takes for them and not only what handing them over takes: by its timers where they
    work, and by waiting for each pass otherwise.
    """

    def __init__(self, gpu: Gpu, true_times: bool) -> None:
        self._gpu = gpu
        self._waits = true_times and not gpu.gl.has_timers
        self._asks = true_times and gpu.gl.has_timers
        self._asked: list[tuple[str, moderngl.Query, float]] = []
        self.ms: dict[str, float] = {}

    def run(self, name: str, make: Make, frame: FrameState, *, draws: bool = False) -> None:
        """Make one pass. Raises StoppedError instead when nobody waits for it any more."""
        self._gpu.stop.check()
        start = time.perf_counter()
        if self._asks and draws:
            with self._gpu.gl.timed() as query:
                make(frame)
            handed_over = (time.perf_counter() - start) * 1e3
            self._asked.append((name, query, handed_over))
            self._keep(name, handed_over)
            return
        make(frame)
        if self._waits and draws:
            self._gpu.gl.finish()
        self._keep(name, (time.perf_counter() - start) * 1e3)

    def settle(self) -> None:
        """Ask the GL's timers, once all is drawn: what a pass took there beyond handing it over was waited for by reading."""
        for name, query, handed_over in self._asked:
            beyond = max(0.0, query.elapsed / 1e6 - handed_over)
            self.ms[name] += beyond
            self.ms["read"] = max(0.0, self.ms.get("read", 0.0) - beyond)
        self._asked.clear()

    def _keep(self, name: str, ms: float) -> None:
        self.ms[name] = self.ms.get(name, 0.0) + ms

    def add(self, passes: dict[str, float]) -> None:
        """Keep what passes took that were timed elsewhere."""
        for name, ms in passes.items():
            self.ms[name] = self.ms.get(name, 0.0) + ms


@dataclass(frozen=True)
class RenderedImage:
    """A picture. pixels: (h, w, 4) u1 sRGB, straight alpha, row 0 at the top.

    passes: (name, milliseconds) in order; without true times "read" waits for what the drawing passes began. plan: the
    names of the passes that ran. work: what the GL was made to do. rung: source/antialias that was drawn.
    error_px: how far the outline may be off the original's, pixels; None where that is not known. area: outside it there is
    nothing but background. planned: what was decided before, None for a picture of several meshes. edges: of the silhouette it met.
    ms: from the resolved request to pixels in memory. body: the pixels encoded as was asked for, where the renderer did that.
    """

    pixels: U1
    passes: tuple[tuple[str, float], ...]
    plan: tuple[str, ...]
    rung: str
    error_px: float | None
    area: Tile
    planned: Plan | None = None
    edges: int = 0
    ms: float = 0.0
    work: GlWork = NO_WORK
    body: bytes | None = None

    @property
    def level(self) -> LevelInView | None:
        """What the outline was taken from, None for the original itself."""
        return None if self.planned is None else self.planned.level


def render_frame(gpu: Gpu, asset: MeshAsset, request: RenderRequest, *, true_times: bool = False) -> RenderedImage:
    """Draw one picture. true_times: of each pass (`Timed`); without GL timers that waits after each, and a frame takes a little longer.

    Raises CapabilityError and InvalidRequestError; GlFaultError when the GL reports an error; StoppedError when `gpu.stop` says so.
    """
    view = resolve_camera(request.camera, asset.frame, request.width, request.height, asset.radius)
    return render_view(gpu, asset, request, view, true_times=true_times)


def render_view(gpu: Gpu, asset: MeshAsset, request: RenderRequest, view: View, *, true_times: bool = False) -> RenderedImage:
    """The same for a camera that has been resolved already; that of the request is not looked at."""
    start, before = time.perf_counter(), gpu.gl.work
    with span("plan"):
        plan = plan_frame(request, asset, view, gpu.costs)
    background = None if request.background == "transparent" else parse_color(request.background)
    frame = FrameState(gpu, asset, request, plan, view, background, area=plan.area)
    if frame.area.width:
        frame.grow_area()
    times = Timed(gpu, true_times)
    _draw(frame, [step for step in FRAME if step.name in plan.passes], times)
    ms = (time.perf_counter() - start) * 1e3
    if frame.area.width and plan.mode is not ShadingMode.MASK and not plan.smooth and plan.lines is None:
        edges = len(frame.edges) if plan.level is None and "edges" in plan.passes else None
        gpu.costs.observe(asset, plan.choice.number, plan.terms(view), ms, edges)
    passes, work = tuple(times.ms.items()), gpu.gl.work - before
    return RenderedImage(frame.image, passes, tuple(times.ms), plan.rung, plan.error_px, frame.area, plan, len(frame.edges), ms, work)


def _draw(frame: FrameState, steps: list[Pass], times: Timed) -> None:
    """Run the passes."""
    plan = frame.plan
    for step in steps:
        if not step.each_tile or (plan.smooth and step.make is make_coverage):
            times.run(step.name, step.make, frame, draws=step.draws)
    if not frame.area.width:
        return
    if plan.on_cpu:
        times.add(draw_in_bands(frame))
        return
    for number, tile in enumerate(tiles_of(plan, frame.area)):
        frame.tile = tile
        for step in steps:
            if step.meanwhile and number == 0 and len(frame.asset.faces) >= WORTH_FLUSHING:
                frame.gpu.gl.flush()
            if step.each_tile and (number == 0 or not step.meanwhile):
                times.run(step.name, step.make, frame, draws=step.draws)
    times.settle()
    frame.gpu.gl.check()


def tiles_of(plan: Plan, area: Tile) -> list[Tile]:
    """The tiles that cover a rectangle of the image; none when it is empty."""
    return area.split(TILE_SAMPLES // plan.sample_grid)
