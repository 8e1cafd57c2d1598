"""Which faces make the silhouette's lines.

Image Precision Silhouette Edges, section 3: the layer behind the nearest one, whose intersection with that is the silhouette. Departure,
which section 6 asks for: of the faces behind, only those are drawn that adjoin the nearest layer, or (translated) are seen nearly
edge-on; others would be hidden, or show through a surface that is thinner than they are pulled.
"""

from __future__ import annotations

import math

import numpy as np

from geometry.silhouettes import face_sides
from schemas.conventions import I4, U1
from schemas.lines import LineMethod
from service.kernels.line_faces import (
    all_edges,
    choose_back,
    choose_grazing,
    drop_ties,
    layer_by_facing,
    layer_by_sight,
    layer_edges,
    near_edge_on,
    open_edges,
    touch,
)
from service.line_surface import LineSurface
from service.render.state import FrameState

MOST_SINE = 0.2
"""|V . N| of the farthest from edge-on that pulled faces are drawn: they can widen a line by 1/50 of the radius of curvature."""
SMALL = 4.0
"""Samples that a face can have and yet have none, between them; for pulled faces all are small: hidden ones must not come through."""
GRAZING = 0.1
"""|V . N| below which charcoal makes front faces fatter (section 4)."""


def find_line_faces(frame: FrameState) -> None:
    """Make `frame.layer`, and `frame.back_faces` or the edges that are drawn of them and for charcoal, in `frame.line_ends`."""
    lines, surface, eye = frame.plan.lines, frame.asset.line_surface, frame.view.eye
    assert lines is not None
    planes, positions, faces = surface.planes, surface.positions, surface.faces
    side = face_sides(planes, positions, faces, eye)
    small = math.inf if lines.method is LineMethod.TRANSLATED else SMALL
    scratch = frame.gpu.scratch
    layer, chosen = _nearest_layer(frame, side, small), np.asarray(scratch.array("chosen faces", (len(faces),), np.int32), np.int32)
    frame.layer = layer
    if lines.silhouette is not None and lines.method is LineMethod.TRANSLATED:
        touched = scratch.array("touched vertices", (len(positions),), np.uint8)
        near = scratch.array("near faces", (len(faces),), np.uint8)
        touch(layer, faces, surface.open_vertices, touched)
        near_edge_on(planes, eye, MOST_SINE * _farthest(frame), near)
        frame.back_faces = chosen[: choose_back(layer, touched, near, planes, positions, faces, eye, MOST_SINE, chosen)].copy()
    elif lines.silhouette is not None:
        frame.line_ends["lines_back"] = _silhouette(surface, layer, side, int(lines.method is LineMethod.WIREFRAME))
    if lines.charcoal:
        grazing = chosen[: choose_grazing(layer, planes, positions, faces, eye, GRAZING, chosen)]
        frame.line_ends["charcoal"] = np.empty((3 * len(grazing), 4), np.int32)
        all_edges(grazing, side, faces, frame.line_ends["charcoal"])


def _farthest(frame: FrameState) -> float:
    """What no point of the mesh is farther from the eye than; 1 for directions, which have no distance."""
    eye = frame.view.eye
    return float(np.linalg.norm(eye[:3]) + frame.asset.radius) if eye[3] else 1.0


def _nearest_layer(frame: FrameState, side: U1, small: float) -> U1:
    """(f,) u1."""
    surface = frame.asset.line_surface
    layer = np.empty(len(surface.faces), np.uint8)
    if frame.samples is None:
        layer_by_facing(side, layer)
    else:
        matrix, grid = frame.view.pixels, float(frame.plan.sample_grid)
        drop_ties(frame.samples, matrix, grid, surface.positions, surface.faces, side, surface.turned, surface.inner[1])
        marks = np.empty((len(surface.positions), 2), np.uint8)
        layer_by_sight(frame.samples, small, matrix, grid, surface.positions, side, surface.turned, surface.faces, marks, layer)
    return layer


def _silhouette(surface: LineSurface, layer: U1, side: U1, of_layer: int) -> I4:
    """(n, 4) i4 edges between the nearest layer and faces behind it, and edges of those where nothing is known of what they adjoin.

    of_layer: 1 for rows about the face that is of the layer, 0 for the other.
    """
    (inner, beside), ending = surface.inner, surface.ending
    ends = np.empty((len(inner) + len(ending), 4), np.int32)
    count = layer_edges(layer, of_layer, side, surface.turned, surface.faces, inner, beside, ends)
    count += open_edges(layer, side, surface.faces, ending, ends[count:])
    return ends[:count]
