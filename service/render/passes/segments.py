"""The silhouette's edges in pixels."""

from __future__ import annotations

import numpy as np

from schemas.conventions import I4
from service.render.state import FrameState
from service.silhouette.project import project_edges


def project_segments(frame: FrameState) -> None:
    """Project the edges into `frame.segments` (n, 4) f8."""
    frame.segments = project_edges(frame.view, frame.outlined[0], as_seen(frame, frame.edges))


def as_seen(frame: FrameState, edges: I4) -> I4:
    """Directed edges (s, 2) with the inside on the same side of each in the image, though the view be mirrored."""
    return np.ascontiguousarray(edges[:, ::-1]) if frame.view.mirrored else edges
