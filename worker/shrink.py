"""The shrink passes of a hull: at which sizes, and what is recorded (`worker.kernels.shrink` says how)."""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal

import numpy as np

from geometry.boxes import build_boxes
from geometry.hull_sequence import MOVE
from schemas.conventions import F4, I4
from worker.kernels.collapse import COLLAPSES, STEPS, Progress
from worker.kernels.collapse_mesh import CollapseMesh
from worker.kernels.shrink import Original, new_fit, shrink

Side = Literal["outer", "inner"]

DOUBLINGS = 1
"""Sizes above the one asked for, each twice the next, at which there is a pass.

Measured on a bunny of 69,664 faces, hull of 500: 6.8 % of excess volume with none, 6.3 % with one; 9.9 % without any shrinking.
A pass costs a tenth of all collapses.
"""
PIECE = 100
"""Vertices between two reports: about 0.05 s."""


def shrink_sizes(face_count: int, max_faces: int) -> list[int]:
    """Numbers of faces at which a mesh of face_count faces is shrunk on its way to a hull of max_faces, from many to few."""
    return [size for size in (max_faces << k for k in range(DOUBLINGS, -1, -1)) if size < face_count]


class ShrinkPass:
    """Shrinks the hulls of one original.

    positions (v, 3) f4, faces (f, 3) i4: closed, oriented so that hulls grow to their outside; turned inside out for inner ones.
    """

    def __init__(self, positions: F4, faces: I4, side: Side) -> None:
        corners = np.ascontiguousarray(positions[faces], np.float64)
        order, boxes = build_boxes(positions, faces)
        self._original = Original(positions, faces, corners, order, boxes, 0 if side == "outer" else -1)
        self._fit = new_fit()

    def run(self, mesh: CollapseMesh, record: Progress, report: Callable[[], None]) -> Progress:
        """Move every vertex of the hull once, where it can be moved; the record with the moves. report is called as progress is."""
        alive = _alive(mesh)
        moved, gains = np.empty(PIECE, np.int32), np.empty(PIECE)
        for start in range(0, len(alive), PIECE):
            end = min(start + PIECE, len(alive))
            record = _with_room(record, end - start)
            step = int(record.counters[STEPS])
            count = int(shrink(mesh, self._original, self._fit, alive, start, end, moved, record.positions[step:], gains))
            record.vertices[step : step + count, 0], record.vertices[step : step + count, 1] = moved[:count], MOVE
            record.volume[step : step + count] = -gains[:count]
            record.counters[STEPS] += count
            record.gained[0] -= gains[:count].sum()
            report()
        return record


def _alive(mesh: CollapseMesh) -> I4:
    """(n,) i4: vertices that the collapses have left."""
    ends = mesh.half[mesh.half >= 0]
    return np.unique(mesh.corner[np.concatenate([ends, mesh.opposite[ends]])]).astype(np.int32)


def _with_room(record: Progress, moves: int) -> Progress:
    """The record with room for so many moves beside the collapses that may still come."""
    collapses = len(record.target) // 3 - int(record.counters[COLLAPSES])  # a collapse takes three edges
    needed = int(record.counters[STEPS]) + moves + collapses
    if needed <= len(record.vertices):
        return record
    size = needed + needed // 2
    grown = (np.resize(array, (size, *array.shape[1:])) for array in (record.vertices, record.positions, record.volume))
    return record._replace(**dict(zip(("vertices", "positions", "volume"), grown, strict=True)))
