"""The silhouette's edges in pixels."""

from __future__ import annotations

import numpy as np

from service.render.state import FrameState
from service.silhouette.project import project_edges


def project_segments(frame: FrameState) -> None:
    """Project the edges into `frame.segments` (n, 4) f8, the inside on the same side of each though the view be mirrored."""
    edges = np.ascontiguousarray(frame.edges[:, ::-1]) if frame.view.mirrored else frame.edges
    frame.segments = project_edges(frame.view, frame.outlined[0], edges)
