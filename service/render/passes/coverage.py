"""The exact area of the silhouette in every pixel."""

from __future__ import annotations

from service.render.state import FrameState
from service.silhouette.coverage import coverage_mask
from service.silhouette.smooth_mask import smooth_mask


def make_coverage(frame: FrameState) -> None:
    """Accumulate the segments into `frame.mask` (h, w) u1, once for all tiles; the curves of a smooth outline take their place.

    Comes after the drawing passes: the GL's threads draw while this one sums.
    """
    if frame.mask is None:
        frame.gpu.gl.flush()
        mask = coverage_mask(frame.segments, frame.view.width, frame.view.height).mask
        frame.mask = mask if frame.smooth is None else smooth_mask(frame.smooth, frame.view, mask)
