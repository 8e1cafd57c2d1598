"""The passes of a clipped picture that need no GL, band of rows by band of rows, by as many threads as call.

A band is small enough to stay in a core's cache from pass to pass, and whoever is free takes the next one.
"""

from __future__ import annotations

from numba import njit

from service.kernels.compositing import put_flat
from service.kernels.coverage_rows import cover
from service.kernels.hull_rim import draw_rim, place_rim
from service.kernels.hull_shading import paint
from service.kernels.hull_visible import SLACK, clip_points, draw_faces, place_faces
from service.kernels.intrinsics import cycles, take

PASSES = ("surface", "rim", "coverage", "composite")
"""In this order, whose time is kept."""


@njit(cache=True, nogil=True)
def place_hull(matrix, surface, sense, y0, y1, points, front, seen, rows, ends, places):
    """Where a hull is in the image: (faces that the rows y0..y1 may show, edges of its outline), how many.

    surface: (positions, faces, uv, edge_vertices, edge_faces). matrix, points: of `hull_visible.clip_points`; sense, front, seen, rows:
    of `hull_visible.place_faces`; ends, places: of `hull_rim.place_rim`. All but the first five are written.
    """
    positions, faces, uv, edge_vertices, edge_faces = surface
    clip_points(matrix, positions, points)
    shown = place_faces(points, faces, sense, y0, y1, front, seen, rows)
    return shown, place_rim(points, faces, uv, edge_vertices, edge_faces, front, ends, places)


@njit(cache=True, nogil=True)
def _clear_beside(image, first, end, area):
    """Make rows first..end of the image transparent outside the area."""
    x0, y0, x1, y1 = area
    for row in range(first, end):
        if row < y0 or row >= y1:
            image[row, :] = 0
        else:
            image[row, :x0] = 0
            image[row, x1:] = 0


@njit(cache=True, nogil=True)
def draw_bands(taken, area, rows, covering, outline, most, hull, rim, half, mask, image, maps, shading, ground, flat, scratch, spent):
    """Draw bands of `rows` rows of the area (x0, y0, x1, y1) until all are taken; taken (1,) i8 counts them, for all threads.

    covering: whether the outline is to be summed into mask (h, w) u1 (`coverage_rows.cover`, at most `most` pieces); else it is
    there already. outline: (segments (s, 4) f8, finite, and of `coverage.by_band` starts, chosen). hull: (points, faces, uv, sense,
    seen, rows) as `hull_visible.draw_faces` takes them, rim: (ends, places) of `hull_rim.place_rim`, half: of its width. image (h, w) u4:
    all of it is written, but what is outside the area only without a ground; maps, shading, ground: as `hull_shading.paint` takes them.
    Without any face to draw, flat u4 is the colour of what the mask covers, when shading[0] is negative. scratch: (of `cover`, of `paint`,
    words i8 (flat), planes (f + e, PLANES) f8). spent (4,) i8: cycles of each of PASSES are added.
    """
    x0, y0, x1, y1 = area
    points, faces, uv, sense, seen, spans = hull
    ends, places = rim
    segments, starts, chosen = outline
    sums, lines, words, planes = scratch
    bare = shading[0] < 0
    while True:
        band = take(taken)
        top = y0 + band * rows
        if top >= y1:
            return
        end = min(top + rows, y1)
        clock = cycles()
        if not ground[0]:
            _clear_beside(image, 0 if band == 0 else top, image.shape[0] if end == y1 else end, area)
        grid = words[: (end - top) * (x1 - x0 + SLACK)].reshape(end - top, x1 - x0 + SLACK)
        if not bare:
            draw_faces(points, faces, uv, sense, seen, spans, x0, top, x1, end, grid, planes)
            spent[0] += cycles() - clock
            clock = cycles()
            draw_rim(ends, places, half, faces.shape[0], x0, top, x1, end, grid, planes)
            spent[1] += cycles() - clock
            clock = cycles()
        if covering:
            cover(segments, chosen[starts[band] : starts[band + 1]], x0, top, x1, end, 0.0, mask, most, sums)
            spent[2] += cycles() - clock
            clock = cycles()
        if bare:
            put_flat(flat, mask[top:end, x0:x1], image[top:end, x0:x1], ground[0], ground[1])
        else:
            paint(grid, planes, x0, top, mask, image, maps, shading, ground, lines)
        spent[3] += cycles() - clock
