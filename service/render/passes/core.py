"""The outline of the mesh's core, a coarse hull that lies inside it: what it covers, the mesh covers too."""

from __future__ import annotations

from geometry.silhouettes import silhouette_simd
from service.render.passes.segments import as_seen
from service.render.state import FrameState
from service.silhouette.project import project_edges


def outline_core(frame: FrameState) -> None:
    """Project the core's silhouette into `frame.core` (n, 4) f8."""
    core = frame.asset.core
    if core is None:
        return
    edges = silhouette_simd(core.planes, core.positions, core.faces, core.edge_vertices, core.edge_faces, frame.view.eye)
    frame.core = project_edges(frame.view, core.positions, as_seen(frame, edges))
