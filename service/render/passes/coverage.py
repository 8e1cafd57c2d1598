"""The exact area of the silhouette in every pixel."""

from __future__ import annotations

from service.render.state import FrameState
from service.silhouette.coverage import coverage_mask
from service.silhouette.smooth_mask import smooth_mask


def make_coverage(frame: FrameState) -> None:
    """Accumulate the segments into `frame.mask` (h, w) u1: the rows of a band, or all of it once for all tiles.

    The curves of a smooth outline take their place. Comes after the drawing passes: the GL's threads draw while this one sums.
    """
    if frame.plan.in_bands:
        if frame.mask is not None:
            rows = (frame.tile.y, frame.tile.y + frame.tile.height)
            coverage_mask(frame.segments, frame.view.width, frame.view.height, frame.mask, rows=rows)
    elif frame.mask is None:
        frame.gpu.gl.flush()
        mask = coverage_mask(frame.segments, frame.view.width, frame.view.height).mask
        frame.mask = mask if frame.smooth is None else smooth_mask(frame.smooth, frame.view, mask)
