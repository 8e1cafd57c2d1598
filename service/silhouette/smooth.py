"""Contours of the smooth surface that a mesh and its normals stand for, as curves.

Sander et al. 2000, Silhouette Clipping, name it as future work. The contour of a mesh zigzags along its edges; that of the
surface with interpolated normals crosses its faces, where the normal is perpendicular to the way to the eye (Hertzmann and
Zorin 2000, Illustrating smooth surfaces). Its nodes are on edges, so there are no more of them than the mesh has edges there.

Departs from that: nodes lie on edges that are curved by the normals, off the mesh, and between nodes run cubic curves of the
image. In the image a contour is perpendicular to the normal, which gives the tangents of each piece: pieces that meet at a
node have the same one there, or, where the contour turns back in a cusp, the opposite one. Creases stay sharp; along
themselves they are curved too.

How far from the mesh: a curved edge keeps within half its length of the straight one, and a piece within half the distance of
its nodes in the image; `reach_px` says by how much that is in a view.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from schemas.conventions import F4, F8, I4, Array
from service.camera import View
from service.kernels import smooth_crossings, smooth_curves, smooth_pieces
from service.kernels.clip import EYE_PLANE
from service.silhouette.contours import link_contours
from service.silhouette.outline import Outline, is_within, outline_of
from service.silhouette.project import following, pixel_matrix, project_loops

TOLERANCE_PX = 0.1
"""How far chords may be from the curves they stand for."""


@dataclass(frozen=True)
class SmoothContours:
    """Closed loops of cubic pieces in an image.

    corners: (k, 3) f8 nodes (u, v, w), u / w and v / w in pixels, y down. inner: (k, 2, 2) f8 pixels, control points of the piece from each
    node to the next of its loop; NaN where it is straight. offsets: (c + 1,) i4, loop i has the nodes [offsets[i], offsets[i + 1]).
    reach_px: how far, at most, they are from the mesh's own projection where they are outside it.
    """

    corners: F8
    inner: F8
    offsets: I4
    reach_px: float

    def flattened(self, width: int, height: int) -> tuple[F8, I4]:
        """(corners (n, 3) f8, offsets (c + 1,) i4) of polygons within TOLERANCE_PX of the curves inside a width x height image."""
        loops = (self.corners, self.offsets, following(self.offsets), self.inner)
        return smooth_pieces.flatten(*loops, float(width), float(height), TOLERANCE_PX)

    def segments(self, view: View) -> F8:
        """(n, 4) f8 pixels: segments of the polygons, as `project.project_edges` makes them of edges."""
        return project_loops(view, *self.flattened(view.width, view.height))


class SmoothSurface:
    """A closed mesh with its normals, ready for any number of views and threads.

    mesh: positions (v, 3) f4 and faces (f, 3) i4. shading: normals (n, 3) f4, the vertex of each (n,) i4, and the rows (f, 3)
    i4 of the faces' corners. edges: edge_vertices and edge_faces (e, 2) i4. All as in `schemas.artifacts.MESH`.
    """

    def __init__(self, mesh: tuple[F4, I4], shading: tuple[F4, I4, I4], edges: tuple[I4, I4]) -> None:
        self._positions = np.asarray(mesh[0])
        self._normals, self._normal_vertices = np.asarray(shading[0]), np.array(shading[1])
        self._edge_vertices, self._edge_faces = np.asarray(edges[0]), np.asarray(edges[1])
        self._rows = edge_rows(np.asarray(mesh[1]), np.asarray(shading[2]), self._edge_vertices, self._edge_faces)

    def contours(self, view: View) -> SmoothContours:
        """The contours of one view, hidden ones too, the front-facing side on their left seen from outside."""
        facing = smooth_crossings.facings(self._positions, self._normals, self._normal_vertices, view.eye)
        nodes, offsets, crease = self._loops(facing)
        after = following(offsets)
        surface = (self._positions, self._normals, self._edge_vertices, self._rows, facing, view.eye)
        points, across, straight = smooth_curves.place_nodes(nodes, *surface)
        tangents = smooth_curves.end_tangents(nodes, after, crease, points, across, *surface)
        matrix = pixel_matrix(view)
        corners = _projected(matrix, points)
        inner = smooth_pieces.inner_points(matrix, corners, after, tangents)
        reach = _reach(corners, _projected(matrix, straight), inner, after)
        return SmoothContours(corners, inner, offsets, reach)

    def _loops(self, facing: F8) -> tuple[Array, I4, Array]:
        """(nodes (k,) i8, offsets (c + 1,) i4, crease (k,) i8 the edge that the piece from each node runs along or -1)."""
        chosen = smooth_crossings.mixed_edges(facing, self._rows)
        ends, parts = smooth_crossings.boundary(chosen, facing, self._rows, self._edge_vertices, self._edge_faces, len(self._positions))
        ends = ends[np.lexsort((ends[:, 1], ends[:, 0]))]
        pieces = np.concatenate([ends[:, 2].reshape(-1, 2), parts[:, :2]])
        crease = np.concatenate([np.full(len(ends) // 2, -1, np.int64), parts[:, 2]])
        loops = link_contours(pieces.astype(np.int32))
        nodes = loops.vertices.astype(np.int64)
        last = nodes[following(loops.offsets)]
        order = np.lexsort((pieces[:, 1], pieces[:, 0]))
        place = np.lexsort((last, nodes))
        along = np.empty(len(nodes), np.int64)
        along[place] = crease[order]
        return nodes, loops.offsets, along


def edge_rows(faces: I4, shading_faces: I4, edge_vertices: I4, edge_faces: I4) -> I4:
    """(e, 2, 2) i4: rows of the normals at the edges' first and last vertices, on their left and right faces."""
    out = np.empty((len(edge_vertices), 2, 2), np.int32)
    for side in range(2):
        beside = edge_faces[:, side]
        for end in range(2):
            corner = np.argmax(faces[beside] == edge_vertices[:, end, None], axis=1)
            out[:, side, end] = shading_faces[beside, corner]
    return out


def smooth_outline(view: View, contours: SmoothContours, base: int = 0) -> Outline:
    """The contours in the image of `view`: as curves, or as polygons where something of them has to be cut off.

    base: layers that fill the whole image (`project.surrounding_layers`).
    """
    corners = contours.corners
    if base <= 0 and is_within(view, corners):
        return Outline(corners[:, :2] / corners[:, 2:], contours.offsets, contours.inner)
    return outline_of(view, *contours.flattened(view.width, view.height), base)


def _projected(matrix: F8, points: F8) -> F8:
    return np.ascontiguousarray(points @ matrix[:, :3].T + matrix[:, 3])


def _reach(corners: F8, straight: F8, inner: F8, after: I4) -> float:
    """Pixels from the mesh to the nodes, and from the nodes' chords to the pieces, at most."""
    seen = (corners[:, 2] >= EYE_PLANE) & (straight[:, 2] >= EYE_PLANE) & ~np.isnan(inner[:, 0, 0])
    if not seen.any():
        return 0.0
    at = corners[:, :2] / np.where(corners[:, 2:] > 0.0, corners[:, 2:], np.nan)
    moved = np.linalg.norm(at - straight[:, :2] / np.where(straight[:, 2:] > 0.0, straight[:, 2:], np.nan), axis=1)[seen]
    chord = (at[after] - at)[seen]
    length = np.linalg.norm(chord, axis=1)
    out = (inner - at[:, None])[seen]
    bulge = np.abs(chord[:, None, 0] * out[..., 1] - chord[:, None, 1] * out[..., 0]).max(axis=1) / np.maximum(length, 1e-12)
    return float(moved.max() + 0.75 * bulge.max())
