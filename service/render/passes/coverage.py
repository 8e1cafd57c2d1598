"""The exact area of the silhouette in every pixel."""

from __future__ import annotations

from service.render.state import FrameState
from service.silhouette.coverage import coverage_mask


def make_coverage(frame: FrameState) -> None:
    """Accumulate the segments into `frame.mask` (h, w) u1, once for all tiles.

    Comes after the drawing passes: the GL's threads draw while this one sums.
    """
    if frame.mask is None:
        frame.gpu.gl.flush()
        frame.mask = coverage_mask(frame.segments, frame.view.width, frame.view.height).mask
