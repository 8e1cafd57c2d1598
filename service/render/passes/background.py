"""The image, with nothing but the background in it."""

from __future__ import annotations

import numpy as np

from service.render.state import FrameState, as_words, word_of


def make_background(frame: FrameState) -> None:
    """Make `frame.image`: transparent black, or opaque in the background's colour. The CPU's bands clear what they are given."""
    size = (frame.view.height, frame.view.width, 4)
    if frame.background is not None:
        frame.image = np.empty(size, np.uint8)
        as_words(frame.image)[...] = word_of(frame.background)
    elif frame.plan.on_cpu and frame.area.width:
        frame.image = np.empty(size, np.uint8)
    else:
        frame.image = np.zeros(size, np.uint8)
