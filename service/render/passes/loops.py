"""Small loops for the stencil, from the silhouette's contours (Silhouette Clipping, section 6, "Loop Decomposition")."""

from __future__ import annotations

from service.kernels.loops import triangle_loops
from service.render.state import FrameState
from service.silhouette.contours import link_contours


def make_loops(frame: FrameState) -> None:
    """Link the edges into `frame.contours` and decompose those into `frame.triangles`."""
    frame.contours = link_contours(frame.edges)
    frame.triangles = triangle_loops(frame.contours.offsets)
