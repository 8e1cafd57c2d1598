"""Strokes along vector lines: over everything, since what of them is hidden was left out before."""

from __future__ import annotations

from service.render.passes.line_draw import draw_strokes
from service.render.state import FrameState


def draw_vector_strokes(frame: FrameState) -> None:
    """Draw them, each kind in its style."""
    for strokes in frame.strokes.get("strokes", []):
        draw_strokes(frame, strokes)
