"""Lines of an image as strokes: width and opacity that follow depth, curvature or angle, dashes, and a wobble.

Based on: Northrup and Markosian 2000 (Artistic silhouettes: a hybrid approach), whose strokes are chains of visible pieces with a width
along them. Departures: the chains are exact ones (`service.silhouette.lines`), so that nothing has to be made straight that pixels
have broken up; the wobble is one of the image (`service.kernels.stroke_paths`); and opacity goes in levels that lie over one another, each
blended once, so that a line does not darken where it overlaps itself.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import replace

import numpy as np

from schemas.conventions import F4, F8, I4, Array
from schemas.lines import LineKind, Stroke, StrokeBy
from schemas.render import SilhouetteRequest
from service.camera import View
from service.kernels import line_shapes, stroke_outlines, stroke_paths
from service.kernels.clip import EYE_PLANE
from service.silhouette.line_mesh import Flags, LineMesh
from service.silhouette.lines import KINDS, VectorLines, rows_in_order, vector_lines
from service.waiting import Stopwatch

FOLLOWS: dict[StrokeBy, int] = {
    "depth": stroke_paths.DEPTH,
    "curvature": stroke_paths.CURVATURE,
    "angle": stroke_paths.ANGLE,
}
THINNED_PX = 0.1
"""Points so near to the line without them are left out before anything else."""
STEP_PX, STEPS_A_SWAY = 2.0, 8.0
"""Pixels between two points of a stroke, at most; steps from one sway of its wobble to the next, at least."""
ROUND_PX = 0.1
"""How far chords may be off round ends and joins."""
HIDDEN_WIDTH, HIDDEN_OPACITY = 0.6, 0.55
"""Of hidden lines: part of the width of visible ones, opacity."""
MOST_LEVELS, LEVEL = 8, 0.04
"""Levels of opacity, and the least that is worth one more."""


def stroked_lines(
    mesh: LineMesh, view: View, wanted: SilhouetteRequest, stroke: Stroke, widths: Mapping[LineKind, float], margin: int
) -> VectorLines:
    """The lines of `vector_lines` as strokes. widths: pixels, of every kind. margin: pixels beyond the image that lines go on for.

    A line may so come back over the border of the image, which its points can be beyond. Dashes are open polylines. Raises CapabilityError
    as `vector_lines`.
    """
    found = vector_lines(mesh, _with_margin(view, margin), wanted)
    clock = Stopwatch()
    found = replace(found, points=found.points - margin, vertices=None)
    styled = stylised(found, stroke, depth_range(mesh.positions, view), np.array([widths[kind] for kind in KINDS]))
    return replace(styled, passes=(*found.passes, ("stroke", clock.ms())))


def moved_px(stroke: Stroke | None) -> float:
    """How far, at most, a stroke's points are from the line it is of, pixels."""
    return 0.0 if stroke is None else THINNED_PX + stroke.wobble_px


def stylised(lines: VectorLines, stroke: Stroke, depths: tuple[float, float], widths: F8) -> VectorLines:
    """Lines as a stroke has them. depths: nearest and farthest of the mesh. widths: (KINDS,) f8 pixels of visible lines."""
    keep = line_shapes.simplify(lines.points, lines.offsets, lines.closed, THINNED_PX)
    counts = np.concatenate([[0], np.cumsum(keep)]).astype(np.int32)
    step = STEP_PX if stroke.wobble_px == 0.0 else min(STEP_PX, stroke.wobble_length_px / STEPS_A_SWAY)
    places, at, offsets, lengths = stroke_paths.resample(lines.points[keep], lines.depths[keep], counts[lines.offsets], lines.closed, step)
    along = (places, at, offsets, lines.closed, lengths, *depths, math.radians(stroke.nib_deg))
    sizes = np.diff(offsets)
    width, opacity = widths[lines.kinds], np.where(lines.visible, 1.0, HIDDEN_OPACITY)
    width = np.where(lines.visible, width, HIDDEN_WIDTH * width)
    columns = [_shares(along, stroke.width_by, stroke.least), _shares(along, stroke.opacity_by, stroke.least)]
    if stroke.wobble_px > 0.0:
        stroke_paths.wobble(places, stroke.seed, stroke.wobble_px, stroke.wobble_length_px)
    found = replace(
        lines,
        points=np.ascontiguousarray(places[:, :2]),
        depths=np.ascontiguousarray(places[:, 2]),
        offsets=offsets,
        vertices=None,
        widths=None if stroke.width_by is None else np.repeat(width, sizes) * columns[0],
        opacities=None if stroke.opacity_by is None else np.repeat(opacity, sizes) * columns[1],
        flat=np.zeros(len(lines), np.bool_),
    )
    return found if stroke.dash is None else _visible_dashed(found, np.array(stroke.dash))


def dashed(lines: VectorLines, pattern: F8) -> VectorLines:
    """Lines cut into dashes, pattern (p,) f8 pixels: dash, gap, ...; open ones with flat ends, in the order of the lines."""
    rows, offsets, of = stroke_paths.dashes(_rows(lines), lines.offsets, lines.closed, pattern)
    return _cut(lines, rows, offsets, of, np.zeros(len(of), np.bool_), np.ones(len(of), np.bool_))


def opacity_levels(lines: VectorLines, opacity: float) -> Iterator[tuple[float, VectorLines]]:
    """(opacity to blend with, lines) one over the other: together they come to the opacities of the lines, times `opacity`, in levels."""
    if lines.opacities is None:
        yield opacity, lines
        return
    if not len(lines):
        return
    low, high = float(lines.opacities.min()), float(lines.opacities.max())
    levels = min(MOST_LEVELS, max(1, math.ceil((high - low) / LEVEL)))
    step, under = (high - low) / levels, 0.0
    for level in range(levels):
        wanted = opacity * (low + (level + 0.5) * step)
        over = (wanted - under) / (1.0 - under) if under < 1.0 else 1.0
        under = wanted
        yield over, lines if level == 0 else _at_least(lines, low + level * step)


def outlines_of(lines: VectorLines, width: float) -> tuple[F8, I4]:
    """(places (k, 2) f8 pixels, offsets (q + 1,) i4) of closed polygons that, filled together by the nonzero rule, are the strokes.

    width: pixels, where the lines have no widths. Polygon i is places[offsets[i]:offsets[i + 1]].
    """
    corners, first = _sides(lines, width)
    places, offsets = stroke_outlines.outlines(corners, first, lines.offsets, lines.closed)
    return places, offsets


def triangles_of(lines: VectorLines, width: float, depth: float) -> tuple[F4, I4]:
    """(vertices (v, 3) f4: x, y and depth, indices (3 t,) i4) of triangles that together are the strokes."""
    corners, first = _sides(lines, width)
    vertices, indices = stroke_outlines.triangles(lines.points, corners, first, lines.offsets, lines.closed, depth)
    return vertices, indices


def depth_range(positions: F4, view: View) -> tuple[float, float]:
    """(nearest, farthest) depth of vertices (v, 3) f4 that are before the eye, along the axis of the view, normalised units."""
    along, shift = positions @ view.view[2, :3].astype(np.float32), float(view.view[2, 3])
    nearest, farthest = -float(along.max()) - shift, -float(along.min()) - shift
    return (nearest if view.orthographic else max(nearest, EYE_PLANE)), farthest


def _with_margin(view: View, margin: int) -> View:
    """The same view in an image that has so many pixels more on every side."""
    if margin == 0:
        return view
    width, height = view.width + 2 * margin, view.height + 2 * margin
    matrix = view.matrix.copy()
    matrix[0] *= view.width / width
    matrix[1] *= view.height / height
    return replace(view, matrix=matrix, width=width, height=height)


def _shares(along: tuple[Array | float, ...], by: StrokeBy | None, least: float) -> F8:
    """(m,) f8 from `least` to 1."""
    if by is None:
        return np.ones(0)
    return np.asarray(least + (1.0 - least) * stroke_paths.strengths(FOLLOWS[by], *along))


def _rows(lines: VectorLines) -> F8:
    """(n, 5) f8: x, y, depth, width and opacity at the points, for what cuts between them."""
    ones = np.ones(len(lines.points))
    widths, opacities = (ones if part is None else part for part in (lines.widths, lines.opacities))
    return np.column_stack([lines.points, lines.depths, widths, opacities])


OPACITY = 4
"""Column of `_rows`."""


def _cut(lines: VectorLines, rows: F8, offsets: I4, of: I4, closed: Flags, flat: Flags) -> VectorLines:
    """The lines made of rows as `_rows` has them; of (d,) i4: which of the lines each is a part of."""
    points, depths, widths, opacities = (np.ascontiguousarray(part) for part in (rows[:, :2], rows[:, 2], rows[:, 3], rows[:, OPACITY]))
    return replace(
        lines, points=points, depths=depths, offsets=offsets, kinds=lines.kinds[of], visible=lines.visible[of], closed=closed, flat=flat,
        vertices=None, widths=None if lines.widths is None else widths, opacities=None if lines.opacities is None else opacities,
    )  # fmt: skip


def _at_least(lines: VectorLines, opacity: float) -> VectorLines:
    """What of the lines is at least so opaque."""
    rows, offsets, of, closed = stroke_paths.above(_rows(lines), lines.offsets, lines.closed, OPACITY, opacity)
    flat = np.zeros(len(of), np.bool_) if lines.flat is None else lines.flat[of]
    return _cut(lines, rows, offsets, of, closed, flat)


def _visible_dashed(lines: VectorLines, pattern: F8) -> VectorLines:
    """Visible lines cut into dashes, hidden ones as they are; of a kind the visible ones still come first."""
    cut, hidden = dashed(lines.chosen(lines.visible), pattern), lines.chosen(~lines.visible)
    kinds, visible, closed = (np.concatenate(pair) for pair in zip(*((a.kinds, a.visible, a.closed) for a in (cut, hidden)), strict=True))
    order = np.argsort(kinds, kind="stable")
    rows, offsets = rows_in_order(np.concatenate([cut.offsets, cut.offsets[-1] + hidden.offsets[1:]]), order)
    both = replace(cut, kinds=kinds, visible=visible)
    return _cut(both, np.concatenate([_rows(cut), _rows(hidden)])[rows], offsets, order.astype(np.int32), closed[order], visible[order])


def _sides(lines: VectorLines, width: float) -> tuple[F8, Array]:
    """(corners, first) of `stroke_outlines.sides`."""
    radii = np.full(len(lines.points), 0.5 * width) if lines.widths is None else 0.5 * lines.widths
    flat = np.zeros(len(lines), np.bool_) if lines.flat is None else lines.flat
    corners, first = stroke_outlines.sides(lines.points, radii, lines.offsets, lines.closed, flat, ROUND_PX)
    return corners, first
