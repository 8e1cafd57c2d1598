"""The outline of the surface with interpolated normals."""

from __future__ import annotations

import math

from service.render.state import FrameState, Tile


def smooth_outline(frame: FrameState) -> None:
    """Make `frame.smooth`, and grow `frame.area` by what it may stick out of the mesh."""
    frame.smooth = frame.asset.smooth_surface.contours(frame.view)
    area, view = frame.area, frame.view
    by = min(math.ceil(frame.smooth.reach_px), view.width + view.height)
    x0, y0 = max(area.x - by, 0), max(area.y - by, 0)
    x1, y1 = min(area.x + area.width + by, view.width), min(area.y + area.height + by, view.height)
    frame.area = Tile(x0, y0, x1 - x0, y1 - y0)
