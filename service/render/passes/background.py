"""The image, with nothing but the background in it."""

from __future__ import annotations

import numpy as np

from service.render.state import FrameState, as_words, word_of


def make_background(frame: FrameState) -> None:
    """Make `frame.image`: transparent black outside the area, which is overwritten, or all in the background's opaque colour."""
    frame.image = np.empty((frame.view.height, frame.view.width, 4), np.uint8)
    words, a = as_words(frame.image), frame.area
    if frame.background is not None:
        words[...] = word_of(frame.background)
    elif not a.width:
        words[...] = 0
    else:
        words[: a.y], words[a.y + a.height :] = 0, 0
        words[a.y : a.y + a.height, : a.x], words[a.y : a.y + a.height, a.x + a.width :] = 0, 0
