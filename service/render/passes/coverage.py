"""The exact area of the silhouette in every pixel."""

from __future__ import annotations

import numpy as np

from schemas.conventions import U1
from service.render.state import FrameState
from service.silhouette.coverage import coverage_mask
from service.silhouette.smooth_mask import smooth_mask


def make_coverage(frame: FrameState) -> None:
    """Accumulate the segments into `frame.mask` (h, w) u1: the rows of a band, or all of it once for all tiles.

    The curves of a smooth outline take their place. Comes after the drawing passes: the GL's threads draw while this one sums.
    """
    if frame.plan.in_bands:
        if frame.mask is not None:
            _cover(frame, frame.mask, (frame.tile.y, frame.tile.y + frame.tile.height))
    elif frame.mask is None:
        frame.gpu.gl.flush()
        mask = np.empty((frame.view.height, frame.view.width), np.uint8)
        _cover(frame, mask, (0, frame.view.height))
        frame.mask = mask if frame.smooth is None else smooth_mask(frame.smooth, frame.view, mask)


def _cover(frame: FrameState, mask: U1, rows: tuple[int, int]) -> None:
    """Write rows of the mask."""
    coverage_mask(frame.segments, frame.view.width, frame.view.height, mask, inside=frame.core, rows=rows)
