"""Edges that are lines whatever the view: boundaries, ridges and valleys (Image Precision Silhouette Edges, section 3.1)."""

from __future__ import annotations

from service.render.passes.line_draw import draw_strokes
from service.render.state import FrameState


def draw_line_edges(frame: FrameState) -> None:
    """Draw their strokes, each kind in its style."""
    for strokes in frame.strokes["line_edges"]:
        draw_strokes(frame, strokes)
