"""Winding numbers of the silhouette in the stencil buffer.

Silhouette Clipping, section 6. Departures: both facings are counted by one draw with a two-sided stencil instead of two
draws with culling; contours are decomposed down to triangles (kernels/loops.py); zero is stored as 128, so that a winding
number that rounding made negative does not count as positive.
"""

from __future__ import annotations

import moderngl

from service.render.state import FrameState


def count_windings(frame: FrameState) -> None:
    """Draw the small loops into the stencil."""
    gpu = frame.gpu
    frame.use_target(color=False, alpha=False, depth=False)
    gpu.ctx.enable_only(moderngl.NOTHING)
    gpu.ctx.front_face = frame.front_face
    gpu.gl.count_windings()
    if frame.contours is not None and len(frame.triangles):
        program = gpu.programs.get("loops", "opaque")
        gpu.programs.set(program, **frame.placement())
        corners = frame.outlined[0][frame.contours.vertices]
        gpu.gl.draw(gpu.streamed(program, corners, "3f", ["in_position"], frame.triangles))
