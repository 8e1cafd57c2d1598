"""A frame: which passes there are, in which order, and where in the image."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

from schemas.conventions import U1
from schemas.render import RenderRequest
from service.assets import MeshAsset
from service.camera import View, resolve_camera
from service.kernels.screen_bounds import SOME, UNKNOWN, screen_bounds
from service.render.bands import draw_in_bands
from service.render.passes.background import make_background
from service.render.passes.clear import clear_target
from service.render.passes.composite import compose
from service.render.passes.coverage import make_coverage
from service.render.passes.edges import find_edges
from service.render.passes.hull import place_hull
from service.render.passes.interior import fill_interior
from service.render.passes.loops import make_loops
from service.render.passes.outline import draw_outline
from service.render.passes.read import read_pixels
from service.render.passes.resolve import resolve_samples
from service.render.passes.rim import draw_rim
from service.render.passes.segments import project_segments
from service.render.passes.smooth import smooth_outline
from service.render.passes.stencil import count_windings
from service.render.passes.surface import draw_surface
from service.render.plan import Plan, plan_frame
from service.render.state import BORDER, FrameState, Gpu, Tile, parse_color
from service.silhouette.levels import LevelInView

Make = Callable[[FrameState], None]


@dataclass(frozen=True)
class Pass:
    """A step of a frame. each_tile: once for every tile; otherwise once for the image. draws: by the GL."""

    name: str
    make: Make
    each_tile: bool = False
    draws: bool = False


FRAME = (
    Pass("background", make_background),
    Pass("edges", find_edges),
    Pass("loops", make_loops),
    Pass("segments", project_segments),
    Pass("smooth", smooth_outline),
    Pass("hull", place_hull),
    Pass("clear", clear_target, each_tile=True, draws=True),
    Pass("stencil", count_windings, each_tile=True, draws=True),
    Pass("surface", draw_surface, each_tile=True, draws=True),
    Pass("rim", draw_rim, each_tile=True, draws=True),
    Pass("outline", draw_outline, each_tile=True, draws=True),
    Pass("interior", fill_interior, each_tile=True, draws=True),
    Pass("coverage", make_coverage, each_tile=True),
    Pass("resolve", resolve_samples, each_tile=True, draws=True),
    Pass("read", read_pixels, each_tile=True),
    Pass("composite", compose, each_tile=True),
)
"""Everything a frame can do, in order; a plan says which of it one frame does."""

TILE_SAMPLES = 2048
"""Samples along a side of a tile: bounds the GL's memory whatever the size of the image."""


class Timed:
    """Runs passes and keeps what each took, milliseconds, in order. wait_each: waits for the GL after those that draw."""

    def __init__(self, gpu: Gpu, wait_each: bool) -> None:
        self._gpu, self._wait = gpu, wait_each
        self.ms: dict[str, float] = {}

    def run(self, name: str, make: Make, frame: FrameState, *, draws: bool = False) -> None:
        """Make one pass."""
        start = time.perf_counter()
        make(frame)
        if self._wait and draws:
            self._gpu.gl.finish()
        self.ms[name] = self.ms.get(name, 0.0) + (time.perf_counter() - start) * 1e3

    def add(self, passes: dict[str, float]) -> None:
        """Keep what passes took that were timed elsewhere."""
        for name, ms in passes.items():
            self.ms[name] = self.ms.get(name, 0.0) + ms


@dataclass(frozen=True)
class RenderedImage:
    """A picture. pixels: (h, w, 4) u1 sRGB, straight alpha, row 0 at the top.

    passes: (name, milliseconds) in order; unless each was waited for, "read" waits for what the drawing passes began. plan: the
    names of the passes that ran. rung: source/antialias that was drawn.
    error_px: how far the outline may be off the original's, pixels; None where that is not known. area: outside it there is
    nothing but background. level: what the outline was taken from, None for the original itself.
    """

    pixels: U1
    passes: tuple[tuple[str, float], ...]
    plan: tuple[str, ...]
    rung: str
    error_px: float | None
    area: Tile
    level: LevelInView | None = None


def render_frame(gpu: Gpu, asset: MeshAsset, request: RenderRequest, *, wait_each: bool = False) -> RenderedImage:
    """Draw one picture. wait_each: wait for the GL after every pass that draws, for true times of each; a frame takes longer so.

    Raises CapabilityError and InvalidRequestError; RuntimeError when the GL reports an error.
    """
    view = resolve_camera(request.camera, asset.frame, request.width, request.height, asset.radius)
    return render_view(gpu, asset, request, view, wait_each=wait_each)


def render_view(gpu: Gpu, asset: MeshAsset, request: RenderRequest, view: View, *, wait_each: bool = False) -> RenderedImage:
    """The same for a camera that has been resolved already; that of the request is not looked at."""
    plan = plan_frame(request, asset, view.eye)
    background = None if request.background == "transparent" else parse_color(request.background)
    level = plan.level_for(view, asset, request.accuracy.max_error_px)
    frame = FrameState(gpu, asset, request, plan, view, background, level)
    frame.area = visible_area(asset, plan, view)
    if frame.area.width:
        frame.grow_area()
    steps = [step for step in FRAME if step.name in plan.passes]
    times = Timed(gpu, wait_each)
    for step in steps:
        early = not step.each_tile or (plan.smooth and step.make is make_coverage)
        if early and (frame.area.width or step.make is make_background):
            times.run(step.name, step.make, frame, draws=step.draws)
    if plan.on_cpu:
        if frame.area.width:
            times.add(draw_in_bands(frame))
    else:
        for tile in tiles_of(plan, frame.area):
            frame.tile = tile
            for step in steps:
                if step.each_tile:
                    times.run(step.name, step.make, frame, draws=step.draws)
        gpu.gl.check()
    error_px = plan.error_px if plan.error_px is None or level is None else plan.error_px + level.error_px
    return RenderedImage(frame.image, tuple(times.ms.items()), tuple(times.ms), plan.rung, error_px, frame.area, level)


def tiles_of(plan: Plan, area: Tile) -> list[Tile]:
    """The tiles that cover a rectangle of the image; none when it is empty."""
    side = TILE_SAMPLES // plan.sample_grid
    return [
        Tile(x, y, min(side, area.x + area.width - x), min(side, area.y + area.height - y))
        for y in range(area.y, area.y + area.height, side)
        for x in range(area.x, area.x + area.width, side)
    ]


def visible_area(asset: MeshAsset, plan: Plan, view: View) -> Tile:
    """The part of the image that can have anything of the mesh in it; empty (no width) when none can."""
    points = asset.corners if plan.hull is None else asset.hulls[plan.hull].hull["positions"]
    kind, x0, y0, x1, y1 = screen_bounds(view.matrix, points, view.width, view.height, BORDER)
    whole = Tile(0, 0, view.width, view.height)
    if kind == SOME:
        return whole.within((x0, y0), (x1, y1))
    return whole if kind == UNKNOWN else Tile(0, 0, 0, 0)
