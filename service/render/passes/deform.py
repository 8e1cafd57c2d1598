"""The vertices of a mesh that was moved, given to the GL where it had them before."""

from __future__ import annotations

from service.render.passes.surface import surface_of
from service.render.state import FrameState


def deform_mesh(frame: FrameState) -> None:
    """Put positions and normals into the surface that is drawn, and positions into the edge mesh where its lines are.

    Indices, edges and textures stay. What else has vertices of its own, such as the surface of face numbers, follows when it is drawn.
    """
    surface_of(frame)
    if "edge_mesh" in frame.plan.passes:
        frame.gpu.cache.edge_mesh(frame.asset)
