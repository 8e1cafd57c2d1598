"""Several meshes in one depth buffer, from their originals: the surfaces of all, then the lines of each against what all have there."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from schemas.conventions import U1
from schemas.render import RenderRequest
from service.assets import MeshAsset
from service.camera import View
from service.kernels.compositing import put_drawn
from service.render.frame import FRAME, Pass, RenderedImage, Timed, tiles_of
from service.render.line_plan import LINE_PASSES
from service.render.passes.clear import clear_target, forget_marks
from service.render.passes.edge_mesh import reach_of
from service.render.passes.read import read_pixels
from service.render.passes.resolve import resolve_samples
from service.render.passes.surface import draw_surface
from service.render.plan import Plan, drawn_there, plan_frame, shared_plan
from service.render.state import LINEAR_TABLE, FrameState, Gpu, as_words
from service.tile import Tile

LINES = tuple(step for step in FRAME if step.name in LINE_PASSES)
BEFORE = tuple(step for step in LINES if not step.each_tile)
MEANWHILE = tuple(step for step in LINES if step.meanwhile)
AFTER = tuple(step for step in LINES if step.each_tile and not step.meanwhile)
"""What the lines of one mesh take: before surfaces are drawn, while the GL draws those of the first tile, and over them in each tile."""


@dataclass(frozen=True)
class Member:
    """A mesh of a group. request: its rung is one of the original without an outline, the same in all members. view: of a camera
    that all members share, so that their depths compare.
    """

    asset: MeshAsset
    request: RenderRequest
    view: View


def render_group(gpu: Gpu, members: Sequence[Member], *, true_times: bool = False) -> RenderedImage:
    """Draw meshes together on a transparent ground. Where lines of two meet, those of the later one are over the others.

    Raises ValueError for members whose rungs differ or have an outline; RuntimeError when the GL reports an error.
    """
    before = gpu.gl.work
    plans = [plan_frame(member.request, member.asset, member.view, gpu.costs) for member in members]
    shared = shared_plan(plans, members[0].view)
    if any(plan.antialias is not shared.antialias for plan in plans) or "edges" in shared.passes:
        raise ValueError("a group is drawn from originals on one rung without outlines")
    frames = [_frame(gpu, member, drawn_there(plan, shared)) for member, plan in zip(members, plans, strict=True) if plan.area.width]
    by_edges = [frame for frame in frames if "edge_mesh" in frame.plan.passes]
    for place, frame in enumerate(by_edges):
        frame.line_place = place, len(by_edges)
    view, area = members[0].view, _around([plan.area for plan in plans if plan.area.width])
    image = np.zeros((view.height, view.width, 4), np.uint8)
    times = Timed(gpu, true_times)
    for frame in frames:
        _make(BEFORE, frame, times)
    whole, tiles = _frame(gpu, members[0], shared), tiles_of(shared, area)
    margin = _margin(by_edges) if len(tiles) > 1 else 0
    for number, tile in enumerate(tiles):
        whole.tile = tile.grown(margin, view.width, view.height)
        _draw_tile(whole, frames, times, first=number == 0)
        if whole.drawn is not None:
            _put(whole.drawn, whole.tile, image, tile)
    times.settle()
    gpu.gl.check()
    passes, error_px = tuple(times.ms.items()), None if any(plan.lines for plan in plans) else shared.error_px
    return RenderedImage(image, passes, tuple(times.ms), shared.rung, error_px, area, work=gpu.gl.work - before)


def _draw_tile(whole: FrameState, frames: list[FrameState], times: Timed, *, first: bool) -> None:
    times.run("clear", clear_target, whole, draws=True)
    for frame in frames:
        frame.tile, frame.target = whole.tile, whole.target
        times.run("surface", draw_surface, frame, draws=True)
    if first:
        whole.gpu.gl.flush()
        for frame in frames:
            _make(MEANWHILE, frame, times)
    for frame in frames:
        if frame.plan.marked:
            forget_marks(frame)
        _make(AFTER, frame, times)
    if "resolve" in whole.plan.passes:
        times.run("resolve", resolve_samples, whole, draws=True)
    times.run("read", read_pixels, whole)


def _margin(frames: list[FrameState]) -> int:
    """Pixels beyond a tile whose depth tells which lines in it are hidden."""
    return max((reach_of(frame.plan.lines, frame.view) for frame in frames if frame.plan.lines), default=0)


def _put(drawn: U1, around: Tile, image: U1, tile: Tile) -> None:
    """Into a tile of the image, from what was drawn around it."""
    x, y = tile.x - around.x, tile.y - around.y
    out = as_words(image)[tile.y : tile.y + tile.height, tile.x : tile.x + tile.width]
    put_drawn(np.ascontiguousarray(as_words(drawn)[y : y + tile.height, x : x + tile.width]), out, False, LINEAR_TABLE)


def _make(steps: Sequence[Pass], frame: FrameState, times: Timed) -> None:
    """Those of the steps that the mesh's plan has."""
    for step in steps:
        if step.name in frame.plan.passes:
            times.run(step.name, step.make, frame, draws=step.draws)


def _frame(gpu: Gpu, member: Member, plan: Plan) -> FrameState:
    return FrameState(gpu, member.asset, member.request, plan, member.view, None, area=plan.area)


def _around(areas: list[Tile]) -> Tile:
    """The smallest rectangle that holds them all."""
    if not areas:
        return Tile(0, 0, 0, 0)
    x0, y0 = min(a.x for a in areas), min(a.y for a in areas)
    x1, y1 = max(a.x + a.width for a in areas), max(a.y + a.height for a in areas)
    return Tile(x0, y0, x1 - x0, y1 - y0)
