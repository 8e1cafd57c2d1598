"""The outline of the surface with interpolated normals."""

from __future__ import annotations

from service.render.state import FrameState


def smooth_outline(frame: FrameState) -> None:
    """Make `frame.smooth`, and grow `frame.area` by what it may stick out of the mesh."""
    frame.smooth = frame.asset.smooth_surface.contours(frame.view)
    frame.grow_area()
