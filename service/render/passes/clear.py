"""An empty target for the tile."""

from __future__ import annotations

from schemas.render import Antialias
from service.render.plan import Plan
from service.render.state import FrameState
from service.render.targets import Kind


def clear_target(frame: FrameState) -> None:
    """Take a framebuffer for the tile and clear its colour, alpha and depth."""
    gpu = frame.gpu
    samples = gpu.gl.most_samples if frame.plan.antialias is Antialias.MSAA else 0
    deep = frame.plan.deep
    frame.target = gpu.targets.get(frame.tile.width * frame.scale, frame.tile.height * frame.scale, samples, kind=_kind(frame.plan))
    framebuffer = frame.use_target(color=True, alpha=True, depth=True)
    gpu.gl.ignore_windings()
    gpu.gl.reverse_depth(deep)
    framebuffer.clear(depth=0.0 if deep else 1.0)
    if frame.plan.marked:
        forget_marks(frame)


def forget_marks(frame: FrameState) -> None:
    """Every sample of the target may be blended with anew."""
    frame.use_target(color=True, alpha=True, depth=True)
    frame.marked = 0
    frame.gpu.gl.clear_marks()


def _kind(plan: Plan) -> Kind:
    """The framebuffer that the passes need."""
    if "edge_mesh" in plan.passes:
        return Kind.DEEP_READABLE if plan.deep else Kind.READABLE
    return Kind.DEEP_MARKED if plan.marked else Kind.DEEP if plan.deep else Kind.PICTURE
