"""The exact area of the silhouette in every pixel."""

from __future__ import annotations

from service.render.state import FrameState, Tile
from service.silhouette.coverage import coverage_mask


def make_coverage(frame: FrameState) -> None:
    """Accumulate the segments into `frame.mask` (h, w) u1; nothing outside its bounds needs to be drawn."""
    coverage = coverage_mask(frame.segments, frame.view.width, frame.view.height)
    frame.mask = coverage.mask
    x0, y0, x1, y1 = coverage.bounds
    frame.area = Tile(x0, y0, x1 - x0, y1 - y0)
