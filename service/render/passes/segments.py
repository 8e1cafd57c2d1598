"""The silhouette's edges in pixels."""

from __future__ import annotations

from service.render.state import FrameState
from service.silhouette.project import project_edges


def project_segments(frame: FrameState) -> None:
    """Project the edges into `frame.segments` (n, 4) f8."""
    frame.segments = project_edges(frame.view, frame.asset.positions, frame.edges)
