"""The silhouette's edges, from the search tree."""

from __future__ import annotations

from service.render.state import FrameState


def find_edges(frame: FrameState) -> None:
    """Extract `frame.edges` (s, 2) i4, directed, front-facing side on the left."""
    if frame.asset.tree is not None:
        frame.edges = frame.asset.tree.extract(frame.view.eye).edges
