"""Rims of front faces that are seen nearly edge-on, over their neighbours (Image Precision Silhouette Edges, section 4)."""

from __future__ import annotations

from service.render.passes.line_draw import draw_strokes
from service.render.state import FrameState


def draw_charcoal(frame: FrameState) -> None:
    """Draw the strokes of charcoal."""
    for strokes in frame.strokes["charcoal"]:
        draw_strokes(frame, strokes)
