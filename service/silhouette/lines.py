"""The lines of a mesh in an image as polylines, each piece of them in sight or hidden: found in space, exactly, not in pixels.

Based on: Fast Silhouettes (GameDev.net, 2007) for what lines are. Hidden lines are told from others as Appel 1967 (The notion of
quantitative invisibility) does: what hides a line changes only where a contour passes before it. Departs from it: nothing is counted along
the lines; pieces between such crossings are joined at vertices, and rays tell of each set of them (`service.kernels.line_sight`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from schemas.conventions import F8, I4, Array
from schemas.errors import CapabilityError
from schemas.lines import LineKind
from schemas.render import SilhouetteRequest
from service.camera import View
from service.kernels import line_chains, line_cuts, line_image, line_kinds, line_pieces, line_shapes, line_sight
from service.silhouette.line_mesh import Flags, LineMesh
from service.silhouette.project import pixel_matrix
from service.waiting import Stopwatch

KINDS = tuple(LineKind)
"""By the numbers that the kernels have for them."""
USUAL_CUTS = 1 << 14
MOST_CUTS = 4_000_000
"""Crossings of lines and contours in an image; where there are more, they are refused: triangles without neighbours come to that."""


@dataclass(frozen=True)
class VectorLines:
    """Polylines of an image, those of a kind one after the other, those in sight first.

    points (n, 2) f8 pixels, y down; polyline i is points[offsets[i]:offsets[i + 1]], offsets (l + 1,) i4; of a closed one the last point
    joins the first. kinds (l,) u1: rows of KINDS. visible, closed (l,) bool. vertices (n,) i4: the vertex of the mesh at each point, -1
    where none is; None when the points were moved. depths (n,) f8: from the eye along the axis of the view, normalised units.
    Of strokes only (`service.silhouette.strokes`): widths (n,) f8 pixels and opacities (n,) f8 at the points where they change along the
    lines, flat (l,) bool polylines without round ends. passes: what each step took, milliseconds. rays: how many were cast.
    """

    points: F8
    offsets: I4
    kinds: Array
    visible: Flags
    closed: Flags
    vertices: I4 | None
    depths: F8
    widths: F8 | None = None
    opacities: F8 | None = None
    flat: Flags | None = None
    passes: tuple[tuple[str, float], ...] = ()
    rays: int = 0

    def __len__(self) -> int:
        return len(self.kinds)

    def polylines(self) -> list[F8]:
        """The points of each."""
        return [self.points[a:b] for a, b in pairwise(self.offsets.tolist())]

    def chosen(self, which: Flags) -> VectorLines:
        """Some of them, which (l,) bool."""
        sizes = np.diff(self.offsets)
        rows = np.repeat(which, sizes)
        offsets = np.concatenate([[0], np.cumsum(sizes[which])]).astype(np.int32)
        return replace(
            self,
            points=self.points[rows],
            offsets=offsets,
            kinds=self.kinds[which],
            visible=self.visible[which],
            closed=self.closed[which],
            vertices=None if self.vertices is None else self.vertices[rows],
            depths=self.depths[rows],
            widths=None if self.widths is None else self.widths[rows],
            opacities=None if self.opacities is None else self.opacities[rows],
            flat=None if self.flat is None else self.flat[which],
        )


@dataclass(frozen=True)
class Segments:
    """Lines in space: ends (n, 6) f8; nodes (n, 2) i4: vertices, and from v on other places; rows (n,) i4: of `Crossings.pierced_starts`;
    owners (n, 2) i4: faces that an intersection is in, -1 of an edge; kinds (n,) u1: rows of KINDS."""

    ends: F8
    nodes: I4
    rows: I4
    owners: I4
    kinds: Array

    def chosen(self, which: Array) -> Segments:
        """Some of them."""
        return Segments(self.ends[which], self.nodes[which], self.rows[which], self.owners[which], self.kinds[which])

    def before(self, other: Segments) -> Segments:
        """These and then others."""
        return Segments(
            np.concatenate([self.ends, other.ends]),
            np.concatenate([self.nodes, other.nodes]),
            np.concatenate([self.rows, other.rows]),
            np.concatenate([self.owners, other.owners]),
            np.concatenate([self.kinds, other.kinds]),
        )


@dataclass(frozen=True)
class Pieces:
    """Lines cut where they may go out of sight.

    segments: those that are in the image; image (n, COLUMNS) f8: the same there (`service.kernels.line_image`). line (p,) i4: the segment
    of each piece; spans (p, 2) f8: which part of it in the image; visible (p,) bool. rays: how many were cast.
    """

    segments: Segments
    image: F8
    line: I4
    spans: F8
    visible: Flags
    rays: int


def vector_lines(mesh: LineMesh, view: View, wanted: SilhouetteRequest) -> VectorLines:
    """The lines of the wanted kinds, those that are hidden too unless only visible ones are asked for.

    Raises CapabilityError for a mesh whose faces, or whose lines in the image, cross too often.
    """
    passes = Passes()
    pieces = find_pieces(mesh, view, wanted, passes)
    runs = line_chains.runs_of(pieces.image, pieces.segments.nodes, pieces.segments.kinds, pieces.line, pieces.spans, pieces.visible)
    found = _shaped(_chained(runs, wanted.visible_only, len(mesh.positions)), wanted)
    depths = -found.depths if view.orthographic else 1.0 / found.depths
    passes.end("chains")
    return replace(found, depths=depths, passes=tuple(passes.ended), rays=pieces.rays)


class Passes:
    """What each step takes, one after the other."""

    def __init__(self) -> None:
        self.ended: list[tuple[str, float]] = []
        self._clock, self._before = Stopwatch(), 0.0

    def end(self, name: str) -> None:
        """The step of this name has ended, and the next begins."""
        now = self._clock.ms()
        self.ended.append((name, now - self._before))
        self._before = now


def find_pieces(mesh: LineMesh, view: View, wanted: SilhouetteRequest, passes: Passes) -> Pieces:
    """The lines of the wanted kinds, cut, each piece in sight or not. Raises CapabilityError as `vector_lines`."""
    eye = np.ascontiguousarray(view.eye)
    crossings = mesh.crossings()
    passes.end("crossings")
    sides = line_kinds.eye_sides(mesh.positions, mesh.faces, eye)
    segments = _wanted_segments(mesh, sides, wanted)
    contours = _edge_segments(mesh, line_kinds.contour_edges(sides, mesh.fans.starts, mesh.fans.halves, mesh.meeting))
    passes.end("kinds")
    image, kept = _projected(view, segments.ends)
    segments = segments.chosen(kept)
    before, kept = _projected(view, contours.ends)
    cuts, of = _cuts(image, segments.nodes, before, contours.nodes[kept], view)
    starts, cuts = line_pieces.cuts_by_line(image, cuts, of, segments.rows, crossings.pierced_starts, crossings.pierced_at)
    line, spans, free = line_pieces.cut_lines(image, starts, cuts)
    passes.end("cuts")
    visible, rays = line_sight.pieces_in_sight(
        (mesh.positions, mesh.faces), mesh.boxes, sides, eye, mesh.rings, crossings.touched,
        image, segments.nodes, segments.ends, segments.owners, line, spans, free,
    )  # fmt: skip
    passes.end("sight")
    return Pieces(segments, image, line, spans, visible, int(rays))


def _wanted_segments(mesh: LineMesh, sides: Array, wanted: SilhouetteRequest) -> Segments:
    kinds = wanted.kinds or [LineKind.SILHOUETTE]
    flags = np.array([kind in kinds for kind in KINDS])
    angles = np.zeros(line_kinds.KINDS)
    angles[line_kinds.RIDGE], angles[line_kinds.VALLEY] = math.radians(wanted.ridge_deg), math.radians(wanted.valley_deg)
    angles[line_kinds.CREASE] = math.radians(wanted.crease_deg)
    fans = mesh.fans
    edges, kind = line_kinds.line_edges(sides, fans.starts, fans.halves, mesh.meeting, mesh.turn, mesh.angle, flags, angles)
    found = replace(_edge_segments(mesh, edges), kinds=kind)
    if LineKind.INTERSECTION not in kinds:
        return found
    crossings = mesh.crossings()
    count = len(crossings.ends)
    rows = np.arange(len(mesh.fans.vertices), len(mesh.fans.vertices) + count, dtype=np.int32)
    more = np.full(count, line_kinds.INTERSECTION, np.uint8)
    return found.before(Segments(crossings.ends, crossings.nodes, rows, crossings.owners, more))


def _edge_segments(mesh: LineMesh, edges: I4) -> Segments:
    nodes = mesh.fans.vertices[edges]
    ends = mesh.positions[nodes].astype(np.float64).reshape(-1, 6)
    return Segments(ends, nodes, edges, np.full((len(edges), 2), -1, np.int32), np.zeros(len(edges), np.uint8))


def _projected(view: View, ends: F8) -> tuple[F8, I4]:
    image, kept = line_image.project_segments(
        np.ascontiguousarray(pixel_matrix(view)), -view.view[2], view.orthographic, ends, float(view.width), float(view.height)
    )
    return image, kept


def _cuts(lines: F8, nodes: I4, contours: F8, contour_nodes: I4, view: View) -> tuple[F8, I4]:
    room = USUAL_CUTS
    while True:
        cuts, of = np.empty(room), np.empty(room, np.int32)
        size = (float(view.width), float(view.height))
        count = line_cuts.find_cuts(lines, nodes, contours, contour_nodes, *size, MOST_CUTS, cuts, of)
        if count > MOST_CUTS:
            raise CapabilityError(f"lines of this mesh cross more than {MOST_CUTS:,} times in this image", field="kinds")
        if count <= room:
            return cuts[:count], of[:count]
        room = count


def _chained(runs: tuple[F8, I4, Array, Flags], visible_only: bool, vertex_count: int) -> VectorLines:
    """The polylines; their depths are how near they are still, which is linear in the image."""
    pieces, at, kind, visible = (part[runs[3]] for part in runs) if visible_only else runs
    ends, offsets, closed = line_chains.chain(pieces, at, kind, visible)
    places, nodes, starts = line_chains.polylines(pieces, at, ends, offsets, closed)
    first = ends[offsets[:-1]] // 2
    kinds, visible = kind[first], visible[first]
    order = np.lexsort((~visible, kinds))
    rows, offsets = rows_in_order(starts, order)
    nodes = np.where(nodes < vertex_count, nodes, -1)[rows]
    points, near = _split(places[rows])
    return VectorLines(points, offsets, kinds[order], visible[order], closed[order], nodes, near)


def rows_in_order(offsets: I4, order: Array) -> tuple[Array, I4]:
    """(rows (n,), offsets (l + 1,) i4) that put polylines, i from offsets[i] to offsets[i + 1], into another order."""
    sizes = np.diff(offsets)[order]
    starts = np.concatenate([[0], np.cumsum(sizes)]).astype(np.int32)
    return np.arange(offsets[-1]) + np.repeat(offsets[:-1][order] - starts[:-1], sizes), starts


def _split(places: F8) -> tuple[F8, F8]:
    """Points, and what is beside them."""
    return np.ascontiguousarray(places[:, :2]), np.ascontiguousarray(places[:, 2])


def _shaped(found: VectorLines, wanted: SilhouetteRequest) -> VectorLines:
    """With fewer points and round corners, if that is wanted."""
    if wanted.simplify_px is not None:
        keep = line_shapes.simplify(found.points, found.offsets, found.closed, wanted.simplify_px)
        counts = np.concatenate([[0], np.cumsum(keep)]).astype(np.int32)
        assert found.vertices is not None
        points, near = found.points[keep], found.depths[keep]
        found = replace(found, points=points, depths=near, vertices=found.vertices[keep], offsets=counts[found.offsets])
    if wanted.smooth_px is not None:
        places = np.column_stack([found.points, found.depths])
        places, offsets = line_shapes.smooth(places, found.offsets, found.closed, wanted.smooth_px)
        points, near = _split(places)
        found = replace(found, points=points, depths=near, offsets=offsets, vertices=None)
    return found
