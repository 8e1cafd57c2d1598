"""The clipped hull drawn on the CPU, without the GL: which faces show where, its rim, and their colours.

A software GL spends more on a fragment of the hull than all of this does on a pixel, and neither needs to be cleared, waited
for or read back. The colour of a pixel is worked out once, and only where the silhouette covers it.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from schemas.conventions import F8, Array
from schemas.render import ShadingMode
from service.kernels import hull_rim, hull_shading, hull_visible
from service.kernels.compositing import srgb_of
from service.render.hull_cache import HullView, PlacedHull
from service.render.passes.light import light_of
from service.render.state import LINEAR_TABLE, Color, FrameState, as_words, parse_color

COLORS_KEPT = 64


def place_hull(frame: FrameState) -> None:
    """Find where the hull's vertices are in the image: `frame.placed`."""
    surface = frame.gpu.hulls.get(frame.asset)
    points = frame.gpu.scratch.array("points", (len(surface.positions), 4), np.float64)
    hull_visible.clip_points(_pixels_from_object(frame), surface.positions, points)
    frame.placed = PlacedHull(surface, points)


def draw_hull(frame: FrameState) -> None:
    """Find which face of the hull each pixel of the tile shows: `frame.hull`."""
    placed, scratch, t = frame.placed, frame.gpu.scratch, frame.tile
    if placed is None:
        raise RuntimeError("the hull was not placed in the image before it was drawn")
    s = placed.surface
    planes = scratch.array("planes", (len(s.faces) + len(s.edge_faces), hull_visible.PLANES), np.float64)
    front = scratch.array("front", (len(s.faces),), np.bool_)
    words = scratch.array("words", (t.height, t.width + hull_visible.SLACK), np.int64)
    sense = -1.0 if frame.view.mirrored else 1.0
    hull_visible.draw_faces(placed.points, s.faces, s.uv, sense, t.x, t.y, t.x + t.width, t.y + t.height, words, planes, front)
    frame.hull = HullView(placed, planes, front, words)


def draw_hull_rim(frame: FrameState) -> None:
    """Give pixels beside the hull a place on its nearest silhouette edge."""
    view, t = frame.hull, frame.tile
    if view is None:
        return
    s = view.placed.surface
    hull_rim.draw_rim(
        view.placed.points, s.faces, s.uv, s.edge_vertices, s.edge_faces, view.front, hull_rim.LEAST_HALF_WIDTH + frame.beyond_px,
        t.x, t.y, t.x + t.width, t.y + t.height, view.words, view.planes,
    )  # fmt: skip


def paint_hull(frame: FrameState, view: HullView) -> None:
    """Colour the pixels of the tile that `frame.mask` covers, over the background in `frame.image`."""
    if frame.mask is None:
        return
    shading, surface = frame.request.shading, view.placed.surface
    shown = hull_shading.FLAT
    if shading.mode is ShadingMode.NORMAL:
        shown = hull_shading.NORMALS
    elif shading.use_mesh_color and surface.colors is not surface.normals:
        shown = hull_shading.TINTED
    turn = np.eye(3, dtype=np.float32) if frame.view.normal_matrix is None else frame.view.normal_matrix.astype(np.float32, order="C")
    hull_shading.paint(
        view.words, view.planes, frame.tile.x, frame.tile.y, frame.mask, as_words(frame.image),
        (surface.normals, surface.colors, *surface.size), shown,
        turn, light_of(frame).astype(np.float32), np.float32(shading.ambient),
        palette(parse_color(shading.color)), ENCODED, LINEAR_TABLE, frame.background is not None,
    )  # fmt: skip


ENCODED = srgb_of(np.linspace(0.0, 1.0, hull_shading.LEVELS))
"""(LEVELS,) u1: sRGB of each amount of linear light."""


@lru_cache(COLORS_KEPT)
def palette(color: Color) -> Array:
    """(LEVELS,) u4: the word of a surface of this sRGB colour under each amount of light, without alpha."""
    words = np.zeros((hull_shading.LEVELS, 4), np.uint8)
    words[:, :3] = srgb_of(np.linspace(0.0, 1.0, hull_shading.LEVELS)[:, None] * LINEAR_TABLE[list(color)].astype(np.float64))
    return words.view("<u4")[:, 0].copy()


def _pixels_from_object(frame: FrameState) -> F8:
    """(4, 4) f8: homogeneous pixels u, v (down), depth and w from the normalised frame."""
    m, view = frame.view.matrix, frame.view
    return np.stack([(m[0] + m[3]) * (0.5 * view.width), (m[3] - m[1]) * (0.5 * view.height), m[2], m[3]])
