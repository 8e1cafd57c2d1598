"""Strokes along the edges that are lines, in pixels: their shapes, widths and depths.

Image Precision Silhouette Edges: edges of back faces (section 3.1), the rims of fattened faces (3.3), those of front faces
seen nearly edge-on and widths by distance (4, 6). Departures: fattening is done in the image, where a width is so many pixels whatever the
perspective, with the depth of the face's plane, which rises so far at most that no sliver comes before the rest;
corners are round instead of cut, so that the strokes of different faces meet.
"""

from __future__ import annotations

import math

import numpy as np

from schemas.conventions import I4
from schemas.lines import LineMethod, Lines, LineStyle
from service.kernels.stroke_turns import turns_at_ends
from service.kernels.strokes import LARGEST_GAIN, Pen, StrokeView, corners_of, make_strokes
from service.render.deep import NEAREST_PART, depth_row, pixel_depth
from service.render.line_plan import DRAWN_KINDS, reference_depth
from service.render.state import FrameState, Strokes
from service.silhouette.lines import KINDS, VectorLines
from service.silhouette.strokes import opacity_levels, triangles_of

ROUND_PX = 0.3
"""How far a round end may be off a circle, pixels."""
NEARER_RADII, NEARER_PX = 3.0, 1.0
"""Strokes on edges are drawn nearer by so many radii and pixels, in pixels' sizes: the surface beside may rise 3 on each pixel."""
MOST_RISE = 1.0
"""A silhouette's edges are drawn nearer by what the surface beside rises, at most so much on each pixel."""
FOLD_PX = 2.0
"""Silhouettes are drawn farther by so many pixels' sizes: what is behind a fold must be farther than that, so that
the roughness of scans is not all lines."""
FIT_MARGIN = 1.02
NEAREST = 1.0
"""Depth that nothing hides."""


def make_line_strokes(frame: FrameState) -> None:
    """Make `frame.strokes` for the passes that draw them."""
    lines = frame.plan.lines
    assert lines is not None
    if frame.vector_lines is not None:
        frame.strokes["strokes"] = _vector_strokes(frame.vector_lines, lines)
        return
    view, style = stroke_view(frame), lines.silhouette or LineStyle()
    if "lines_back" in frame.line_ends:
        ends, fattened = frame.line_ends["lines_back"], lines.method is LineMethod.FATTENED
        pen = _fat_pen(frame, lines, style, 0.0) if fattened else _wire_pen(frame, lines, style)
        frame.strokes["lines_back"] = [_strokes(frame, view, pen, ends, style, fattened)]
    if "charcoal" in frame.line_ends:
        pen = _fat_pen(frame, lines, style, -LARGEST_GAIN)
        frame.strokes["charcoal"] = [_strokes(frame, view, pen, frame.line_ends["charcoal"], style, True)]
    if "line_edges" in frame.plan.passes:
        frame.strokes["line_edges"] = _feature_strokes(frame, view, lines)


def _vector_strokes(found: VectorLines, lines: Lines) -> list[Strokes]:
    """Those of the vector lines, the kind that is drawn over all others last; of those that are blended, each level of their opacity."""
    made = []
    for kind in reversed(DRAWN_KINDS):
        style: LineStyle | None = getattr(lines, kind)
        if style is None:
            continue
        for opacity, level in opacity_levels(found.chosen(found.kinds == KINDS.index(kind)), style.opacity):
            made.append(Strokes(style.model_copy(update={"opacity": opacity}), *triangles_of(level, style.width, NEAREST)))
    return made


def stroke_view(frame: FrameState) -> StrokeView:
    """Where the frame's strokes are."""
    view, area = frame.view, frame.area
    matrix = view.pixels.copy()
    matrix[2] = depth_row(view)
    nearest = 0.5 if view.orthographic else view.far * NEAREST_PART
    rectangle = (float(area.x), float(area.y), float(area.x + area.width), float(area.y + area.height))
    return StrokeView(matrix, view.eye, nearest, *rectangle, *pixel_depth(view), -1.0 if view.mirrored else 1.0)


def pull_of(frame: FrameState, lines: Lines) -> tuple[float, float, float]:
    """(share, shift, by) that the request pulls faces with: depth d at w becomes d (1 + share) w / (w - by) + shift.

    A pull by the slopes of the faces is none here: it is the GL's to do.
    """
    view, amount = frame.view, lines.pull.amount or DEFAULT_PULL[lines.pull.by]
    if lines.pull.by == "offset":
        return 0.0, 0.0, 0.0
    if view.orthographic:  # there is no distance from the eye: a share of the mesh's radius instead
        return 0.0, amount / view.depth_unit / (view.far - view.near), 0.0
    return (0.0, 0.0, amount / view.depth_unit) if lines.pull.by == "fixed" else (amount / (1.0 - amount), 0.0, 0.0)


DEFAULT_PULL = {"fixed": 0.05, "z": 0.02, "offset": 6.0}
"""Radii of the mesh; share of the distance; pixels along the face's slope."""


def _wire_pen(frame: FrameState, lines: Lines, style: LineStyle) -> Pen:
    """Capsules, nearer by what was asked for or fits their width."""
    radius = 0.5 * style.width
    (share, shift), by, rise = pixel_depth(frame.view), 0.0, 0.0
    if lines.pull.amount is None:
        share, shift, rise = -FOLD_PX * share, -FOLD_PX * shift, MOST_RISE
    elif lines.pull.by == "offset":
        share, shift = lines.pull.amount * share, lines.pull.amount * shift
    else:
        share, shift, by = pull_of(frame, lines)
    return Pen(radius, _reference(frame, lines), share, shift, by, _steps(radius), 0.0, rise)


def _edge_pen(frame: FrameState, lines: Lines, style: LineStyle) -> Pen:
    radius = 0.5 * style.width
    nearer = NEARER_RADII * radius + NEARER_PX
    share, shift = pixel_depth(frame.view)
    return Pen(radius, _reference(frame, lines), nearer * share, nearer * shift, 0.0, _steps(radius), 0.0, 0.0)


def _fat_pen(frame: FrameState, lines: Lines, style: LineStyle, least_gain: float) -> Pen:
    width = style.width * (_distance_factor(frame) if lines.declutter else 1.0)
    farther = 0.0 if least_gain < 0.0 else FOLD_PX
    share, shift = pixel_depth(frame.view)
    return Pen(width, _reference(frame, lines), -farther * share, -farther * shift, 0.0, _steps(width), least_gain, 0.0)


def _distance_factor(frame: FrameState) -> float:
    """How much smaller than fitted the mesh is in the picture; 1 when it is not smaller."""
    view = frame.view
    half = 0.5 * min(view.width, view.height)
    if view.orthographic:
        return min(1.0, view.pixel_scale / half)
    fitting = FIT_MARGIN * math.hypot(1.0, view.depth_pixels / half)
    return min(1.0, fitting / max(float(view.matrix[3, 3]), view.near) / view.depth_unit)


def _reference(frame: FrameState, lines: Lines) -> float:
    return reference_depth(frame.view) if lines.scale == "distance" and not frame.view.orthographic else 0.0


def _steps(radius: float) -> int:
    """Pieces of a quarter of a circle that are within ROUND_PX of it."""
    return max(1, math.ceil(0.25 * math.pi / math.acos(1.0 - min(ROUND_PX / radius, 0.5))))


def _feature_strokes(frame: FrameState, view: StrokeView, lines: Lines) -> list[Strokes]:
    """Those of boundaries, ridges and valleys; what is silhouette already is not drawn again."""
    surface, layer, made = frame.asset.line_surface, frame.layer, []
    for style, ends in (
        (lines.boundary, surface.boundary if lines.boundary else None),
        (lines.valley, surface.sharp(lines.valley_deg, layer, convex=False) if lines.valley else None),
        (lines.ridge, surface.sharp(lines.ridge_deg, layer, convex=True) if lines.ridge else None),
    ):
        if style is not None and ends is not None:
            made.append(_strokes(frame, view, _edge_pen(frame, lines, style), ends, style, False))
    return made


def _strokes(frame: FrameState, view: StrokeView, pen: Pen, ends: I4, style: LineStyle, fattened: bool) -> Strokes:
    corners, ends = corners_of(fattened, pen.steps), np.require(ends, requirements=["C", "W"])
    vertices, indices = np.empty((len(ends) * corners, 3), np.float32), np.empty(len(ends) * 3 * (corners - 2), np.int32)
    turns = np.empty((len(ends) if fattened else 0, 2))
    if fattened:
        turns_at_ends(view.matrix, view.nearest, view.flip, frame.asset.positions, ends, turns)
    count = make_strokes(view, pen, frame.asset.positions, ends, turns, vertices, indices)
    return Strokes(style, vertices[: count * corners], indices[: count * 3 * (corners - 2)])
