"""What finding lines needs of a mesh and no eye changes: edges of any triangles, a box hierarchy, where faces cross."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from geometry.boxes import build_boxes
from geometry.edge_fans import EdgeFans, edge_fans, faces_about_vertices
from geometry.topology import face_normals
from schemas.conventions import F4, F8, I4, Array
from schemas.errors import CapabilityError
from service.kernels import line_kinds, self_crossings
from service.silhouette.extract import frozen

MOST_CROSSINGS = 200_000
"""Segments in which faces of a mesh meet; one that has more is refused."""
PLACE_DIGITS = 9
"""Decimals, normalised units, to which segments are the same: a side that lies in a face is one of two faces."""

Flags = npt.NDArray[np.bool_]


@dataclass(frozen=True)
class Crossings:
    """Where the faces of a mesh cross or touch.

    nodes (m, 2) i4: the ends of the segments, vertices of the mesh below v; ends (m, 6) f8: in space; owners (m, 2) i4: both faces.
    touched (v,) bool: vertices at which more than their own faces meet. pierced_at[pierced_starts[i]:pierced_starts[i + 1]]: where
    faces go through edge i, 0 at its lower vertex to 1; from i = e on they are the segments instead of edges.
    """

    nodes: I4
    ends: F8
    owners: I4
    touched: Flags
    pierced_starts: I4
    pierced_at: F8


class LineMesh:
    """Any triangles, ready for any number of eyes and threads. positions (v, 3) f4 normalised, faces (f, 3) i4, f > 0.

    still: the same faces at other positions, whose findings are shared as far as they do not depend on these.
    """

    def __init__(self, positions: F4, faces: I4, still: LineMesh | None = None) -> None:
        self.positions: F4 = frozen(positions, np.float32)
        self.faces: I4 = frozen(faces, np.int32)
        self.fans: EdgeFans = edge_fans(self.faces) if still is None else still.fans
        self.boxes: tuple[Array, Array] = build_boxes(self.positions, self.faces)
        self.rings: tuple[Array, Array] = faces_about_vertices(self.faces, len(self.positions)) if still is None else still.rings
        normals = face_normals(self.positions, self.faces)
        shapes = line_kinds.edge_shapes(self.positions, self.faces, normals, self.fans.starts, self.fans.halves)
        self.meeting, self.turn, self.angle = shapes

    @property
    def nbytes(self) -> int:
        """Bytes of the arrays that are its own."""
        fans = (self.fans.vertices, self.fans.starts, self.fans.halves, self.fans.of_half)
        return sum(int(a.nbytes) for a in (*fans, *self.boxes, *self.rings, self.meeting, self.turn, self.angle))

    def silhouette(self, eye: F8) -> I4:
        """(s, 2) i4: edges of two faces of which one is front-facing for eye (4,) f8, directed as that one has them."""
        sides: npt.NDArray[np.int8] = line_kinds.eye_sides(self.positions, self.faces, np.ascontiguousarray(eye, np.float64))
        first = self.fans.starts[:-1][self.meeting == line_kinds.PAIR]
        one, two = (self.fans.halves[first + i].astype(np.int64) for i in range(2))
        front, other = sides[one // 3] >= 0, sides[two // 3] >= 0
        half = np.where(front, one, two)[front != other]
        return np.column_stack([self.faces[half // 3, half % 3], self.faces[half // 3, (half % 3 + 1) % 3]])

    def crossings(self) -> Crossings:
        """Where its faces cross, found when first asked for. Raises CapabilityError where that is more than MOST_CROSSINGS times."""
        if self._crossings is None:
            message = f"the faces of this mesh cross more than {MOST_CROSSINGS:,} times, too often to tell which lines are hidden"
            raise CapabilityError(message, field="kinds")
        return self._crossings

    @cached_property
    def _crossings(self) -> Crossings | None:
        order, boxes = self.boxes
        found, touched, pierced, keys, ends, owners = self_crossings.self_crossings(
            self.positions, self.faces, order, boxes, self.fans.of_half, MOST_CROSSINGS
        )
        if found[0] > 2 * MOST_CROSSINGS or found[1] > MOST_CROSSINGS:
            return None
        kept, count = _once(ends), len(self.fans.vertices)
        ends, owners, most = ends[kept], owners[kept], 2 * MOST_CROSSINGS
        again, of, at = self_crossings.segments_through(self.positions, self.faces, order, boxes, ends, owners, most)
        if again > most:
            return None
        rows = np.concatenate([pierced[:, 0].astype(np.int64), count + of.astype(np.int64)])
        starts, at = _by_row(rows, np.concatenate([pierced[:, 1], at]), count + len(ends))
        return Crossings(_nodes(keys[kept], len(self.positions)), ends, owners, touched, starts, at)


def _by_row(rows: npt.NDArray[np.int64], places: F8, count: int) -> tuple[I4, F8]:
    """(starts (count + 1,), places): places (n,) by their rows (n,)."""
    starts = np.concatenate([[0], np.cumsum(np.bincount(rows, minlength=count))])
    return starts.astype(np.int32), places[np.argsort(rows, kind="stable")]


def _once(ends: F8) -> Array:
    """Numbers of the segments (m, 6) whose places are not those of an earlier one, in either direction."""
    places = np.round(ends, PLACE_DIGITS).reshape(-1, 2, 3) + 0.0
    rows, axis = np.arange(len(places)), np.argmax(places[:, 0] != places[:, 1], axis=1)
    turned = places[rows, 0, axis] > places[rows, 1, axis]
    ordered = np.where(turned[:, None, None], places[:, ::-1], places).reshape(-1, 6)
    return np.sort(np.unique(ordered, axis=0, return_index=True)[1])


def _nodes(keys: npt.NDArray[np.int64], vertex_count: int) -> I4:
    """(m, 2) i4: keys of `self_crossings` as numbers: vertices, and from vertex_count on the other places."""
    nodes = -1 - keys
    other = keys >= 0
    nodes[other] = vertex_count + np.unique(keys[other], return_inverse=True)[1]
    return np.asarray(nodes, np.int32)
