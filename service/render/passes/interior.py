"""Alpha of the silhouette's interior, from the stencil."""

from __future__ import annotations

import moderngl

from service.render.state import FrameState


def fill_interior(frame: FrameState) -> None:
    """Set alpha to one where the winding number is positive."""
    gpu = frame.gpu
    frame.use_target(color=False, alpha=True, depth=False)
    gpu.ctx.enable_only(moderngl.NOTHING)
    gpu.gl.keep_positive_windings()
    gpu.gl.draw(gpu.screen(gpu.programs.get("screen", "opaque")), vertices=3)
