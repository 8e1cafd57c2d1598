"""Several meshes in one depth buffer, from their originals."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from schemas.conventions import U1
from schemas.render import RenderRequest
from service.assets import MeshAsset
from service.camera import View
from service.kernels.compositing import put_drawn
from service.render.frame import RenderedImage, Timed, tiles_of
from service.render.passes.clear import clear_target
from service.render.passes.read import read_pixels
from service.render.passes.resolve import resolve_samples
from service.render.passes.surface import draw_surface
from service.render.plan import plan_frame
from service.render.state import LINEAR_TABLE, FrameState, Gpu, as_words
from service.tile import Tile


@dataclass(frozen=True)
class Member:
    """A mesh of a group. request: its rung is one of the original without an outline, the same in all members. view: of a camera
    that all members share, so that their depths compare.
    """

    asset: MeshAsset
    request: RenderRequest
    view: View


def render_group(gpu: Gpu, members: Sequence[Member], *, true_times: bool = False) -> RenderedImage:
    """Draw meshes together on a transparent ground.

    Raises ValueError for members whose rungs differ or have an outline; RuntimeError when the GL reports an error.
    """
    before = gpu.gl.work
    frames = [_frame(gpu, member) for member in members]
    first = frames[0]
    if any(f.plan.antialias is not first.plan.antialias or "edges" in f.plan.passes for f in frames):
        raise ValueError("a group is drawn from originals on one rung without outlines")
    view, area = first.view, _around([f.area for f in frames if f.area.width])
    image = np.zeros((view.height, view.width, 4), np.uint8)
    times = Timed(gpu, true_times)
    for tile in tiles_of(first.plan, area):
        _draw_tile(frames, tile, image, times)
    times.settle()
    gpu.gl.check()
    passes, rung = tuple(times.ms.items()), first.plan.rung
    return RenderedImage(image, passes, tuple(times.ms), rung, first.plan.error_px, area, work=gpu.gl.work - before)


def _draw_tile(frames: list[FrameState], tile: Tile, image: U1, times: Timed) -> None:
    first = frames[0]
    first.tile = tile
    times.run("clear", clear_target, first, draws=True)
    for frame in frames:
        frame.tile, frame.target = tile, first.target
        if frame.area.width:
            times.run("surface", draw_surface, frame, draws=True)
    if "resolve" in first.plan.passes:
        times.run("resolve", resolve_samples, first, draws=True)
    times.run("read", read_pixels, first)
    if first.drawn is not None:
        out = as_words(image)[tile.y : tile.y + tile.height, tile.x : tile.x + tile.width]
        put_drawn(as_words(first.drawn), out, False, LINEAR_TABLE)


def _frame(gpu: Gpu, member: Member) -> FrameState:
    plan = plan_frame(member.request, member.asset, member.view, gpu.costs)
    return FrameState(gpu, member.asset, member.request, plan, member.view, None, area=plan.area)


def _around(areas: list[Tile]) -> Tile:
    """The smallest rectangle that holds them all."""
    if not areas:
        return Tile(0, 0, 0, 0)
    x0, y0 = min(a.x for a in areas), min(a.y for a in areas)
    x1, y1 = max(a.x + a.width for a in areas), max(a.y + a.height for a in areas)
    return Tile(x0, y0, x1 - x0, y1 - y0)
