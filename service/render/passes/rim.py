"""Colour for pixels that the outline touches although no surface was drawn at their centre.

The hull encloses the original, but the GL draws where pixel centres are inside. A pixel whose square meets the original while
its centre lies outside the hull is at most half a diagonal from the hull's outline; so rectangles of half a width
of one pixel about the hull's own silhouette edges reach every one of them. Behind everything, they show nowhere else.
"""

from __future__ import annotations

import moderngl
import numpy as np

from geometry.predicates import front_facing
from geometry.topology import EdgeTable
from schemas.conventions import F4, F8, I4, Array
from schemas.render import Antialias, Source
from service.render.gpu_cache import Surface, attributes, corner_rows, fields_of, needs_corners, vertex_rows
from service.render.passes.surface import shaded_program, surface_of
from service.render.programs import set_uniforms
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
    set_uniforms(program, pixel=frame.pixel(), half_width=HALF_WIDTH)
    frame.use_target(color=True, alpha=frame.plan.antialias is not Antialias.LINE, depth=True)
    gpu.gl.ignore_windings()
    gpu.ctx.enable_only(moderngl.DEPTH_TEST)
    fields = fields_of(ends.dtype)
    used = set(program)
    first, first_names = attributes(fields, "a_", used)
    last, last_names = attributes(fields, "b_", used)
    with gpu.passing(program, ends, f"{first} {last}/i", first_names + last_names) as edges:
        edges.render(moderngl.TRIANGLE_STRIP, vertices=4, instances=len(ends))


def _ends(frame: FrameState, surface: Surface) -> Array:
    """(k, 2) rows of the ends of the surface's silhouette edges."""
    asset, source = frame.asset, frame.plan.source
    colored = "color_map" in surface.textures or "COLOR" in surface.definitions
    if not needs_corners(source, colored=colored):
        return vertex_rows(asset, frame.edges)
    if source is Source.CLIPPED and asset.hull is not None:
        faces = asset.hull["faces"]
        edges, left = _hull_silhouette(asset.hull["positions"], faces, asset.hull_edges, frame.view.eye)
    else:
        faces, edges = asset.faces, frame.edges
        left = asset.left_faces(edges)
    corners = 3 * left[:, None] + np.argmax(faces[left][:, None, :] == edges[:, :, None], axis=2)
    return corner_rows(asset, source, corners, colored=colored)


def _hull_silhouette(positions: F4, faces: I4, table: EdgeTable, eye: F8) -> tuple[I4, I4]:
    """The hull's silhouette edges (k, 2), in any direction, and the front-facing face (k,) of each."""
    front = front_facing(positions, faces, eye)
    first, second = front[table.faces[:, 0]], front[table.faces[:, 1]]
    chosen = first != second
    return table.vertices[chosen], np.where(first, table.faces[:, 0], table.faces[:, 1])[chosen]
