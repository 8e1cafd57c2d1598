"""The silhouette's edges, from the search tree of the mesh, or of a level that stands for it."""

from __future__ import annotations

from service.render.state import FrameState
from service.threads import cores


def find_edges(frame: FrameState) -> None:
    """Extract `frame.edges` (s, 2) i4, directed, front-facing side on the left."""
    _, tree = frame.outlined
    if tree is not None:
        frame.edges = tree.extract(frame.view.eye, threads=cores()).edges
