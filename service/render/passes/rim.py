"""Colour for pixels that the outline touches although no surface was drawn at their centre.

The hull encloses the original, but the GL draws where pixel centres are inside. A pixel whose square meets the original while
its centre lies outside the hull is at most half a diagonal from the hull's outline; so rectangles of half a width
of one pixel about the hull's own silhouette edges reach every one of them. Behind everything, they show nowhere else.
"""

from __future__ import annotations

import moderngl

from geometry.predicates import front_facing
from schemas.conventions import Array
from schemas.render import Antialias
from service.render.gpu_cache import Surface, attributes, corner_rows, edge_corners, fields_of
from service.render.passes.surface import shaded_program, surface_of
from service.render.state import FrameState

HALF_WIDTH = 1.0
"""Pixels; sqrt(1/2) would do, the rest is for the rasteriser's grid of 1/256 pixel."""


def draw_rim(frame: FrameState) -> None:
    """Draw the rectangles about the silhouette edges of the surface that was drawn, where nothing is."""
    gpu = frame.gpu
    surface = surface_of(frame)
    ends = _ends(frame, surface)
    if not len(ends):
        return
    program = shaded_program(frame, surface, "rim")
    gpu.programs.set(program, pixel=frame.pixel(), half_width=HALF_WIDTH + frame.beyond_px)
    frame.use_target(color=True, alpha=frame.plan.antialias is not Antialias.LINE, depth=True)
    gpu.gl.ignore_windings()
    gpu.ctx.enable_only(moderngl.DEPTH_TEST)
    fields = fields_of(ends.dtype)
    used = set(program)
    first, first_names = attributes(fields, "a_", used)
    last, last_names = attributes(fields, "b_", used)
    edges = gpu.streamed(program, ends, f"{first} {last}/i", first_names + last_names)
    gpu.gl.draw(edges, moderngl.TRIANGLE_STRIP, vertices=4, instances=len(ends))


def _ends(frame: FrameState, surface: Surface) -> Array:
    """(k, 2) rows of the ends of the surface's silhouette edges."""
    asset, colored = frame.asset, "color_map" in surface.textures or "COLOR" in surface.definitions
    hull = frame.hull
    if surface.edge_ends is not None and hull is not None:
        front = front_facing(hull.hull["positions"], hull.hull["faces"], frame.view.eye)
        beside = front[hull.edges.faces]
        return surface.edge_ends[beside[:, 0] != beside[:, 1]]
    corners = edge_corners(asset.faces, frame.edges, asset.left_faces(frame.edges))
    return corner_rows(asset, None, corners, colored=colored)
