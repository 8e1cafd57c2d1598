"""An empty target for the tile."""

from __future__ import annotations

from schemas.render import Antialias
from service.render.state import FrameState
from service.render.targets import Kind


def clear_target(frame: FrameState) -> None:
    """Take a framebuffer for the tile and clear its colour, alpha and depth."""
    gpu = frame.gpu
    samples = gpu.gl.most_samples if frame.plan.antialias is Antialias.MSAA else 0
    deep = frame.plan.deep
    marked = deep and frame.plan.translucent
    drawn = Kind.READABLE if "edge_mesh" in frame.plan.passes else Kind.PICTURE
    kind = Kind.DEEP_MARKED if marked else Kind.DEEP if deep else drawn
    frame.target = gpu.targets.get(frame.tile.width * frame.scale, frame.tile.height * frame.scale, samples, kind=kind)
    framebuffer = frame.use_target(color=True, alpha=True, depth=True)
    gpu.gl.ignore_windings()
    gpu.gl.reverse_depth(deep)
    framebuffer.clear(depth=0.0 if deep else 1.0)
    frame.marked = 0
    if marked:
        gpu.gl.clear_marks()
