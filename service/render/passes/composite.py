"""Drawn colour, alpha and background as one picture.

Silhouette Clipping composes with OVER while it draws the hull. Here that is done once a pixel, after drawing, so that where
front faces of the hull overlap the background does not shine through twice, and in linear light.
"""

from __future__ import annotations

import numpy as np

from schemas.render import ShadingMode
from service.kernels.compositing import put_drawn, put_flat, put_masked
from service.render.state import LINEAR_TABLE, FrameState, as_words, parse_color, word_of


def compose(frame: FrameState) -> None:
    """Lay what was drawn over the background in `frame.image`, with the mask's alpha where there is a mask."""
    if frame.drawn is None:
        return
    t = frame.tile
    area = np.s_[t.y : t.y + t.height, t.x : t.x + t.width]
    out = as_words(frame.image)[area]
    opaque = frame.background is not None
    drawn = as_words(frame.drawn)
    if frame.mask is not None:
        put_masked(drawn, frame.mask[area], out, opaque, LINEAR_TABLE)
    elif frame.request.shading.mode is ShadingMode.MASK:
        put_flat(_flat(frame), frame.drawn[:, :, 3], out, opaque, LINEAR_TABLE)
    else:
        put_drawn(drawn, out, opaque, LINEAR_TABLE)


def _flat(frame: FrameState) -> np.uint32:
    return word_of(parse_color(frame.request.shading.color))
