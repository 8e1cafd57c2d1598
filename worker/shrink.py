"""The shrink passes of a hull: at which sizes, how many rounds, and what is recorded (`worker.kernels.shrink` says how)."""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal

import numpy as np

from geometry.hull_sequence import MOVE
from schemas.conventions import F4, I4
from worker.kernels.bake_boxes import build_boxes
from worker.kernels.collapse import STEPS, Progress
from worker.kernels.collapse_mesh import CollapseMesh
from worker.kernels.shrink import Original, new_fit, shrink

Side = Literal["outer", "inner"]

DOUBLINGS = 1
"""Sizes above the one asked for, each twice the next, at which there is a round.

Measured on a bunny of 69,664 faces, hull of 500: 6.8 % of excess volume with none, 6.3 % with one, 6.1 % with two; 9.9 %
without any shrinking. A round costs a tenth of all collapses.
"""
ROUNDS, FINAL_ROUNDS = 1, 1
ENOUGH = 0.01
"""A round that takes away less than this part of what the first one took is the last."""
PIECE = 100
"""Vertices between two reports: about 0.05 s."""


def shrink_schedule(face_count: int, max_faces: int) -> list[tuple[int, int]]:
    """(faces, rounds) of the passes over a mesh of face_count faces on its way to a hull of max_faces, from many faces to few."""
    passes = [*((max_faces << k, ROUNDS) for k in range(DOUBLINGS, 0, -1)), (max_faces, FINAL_ROUNDS)]
    return [(size, rounds) for size, rounds in passes if size < face_count]


class ShrinkPass:
    """Shrinks the hulls of one original.

    positions (v, 3) f4, faces (f, 3) i4: closed, oriented so that hulls grow to their outside; turned inside out for inner ones.
    """

    def __init__(self, positions: F4, faces: I4, side: Side) -> None:
        corners = np.ascontiguousarray(positions[faces], np.float64)
        most = np.array([0 if side == "outer" else -1])
        order, boxes = build_boxes(positions, faces)
        self._original = Original(positions, faces, corners, order, boxes, most)
        self._fit = new_fit()

    def run(self, mesh: CollapseMesh, record: Progress, rounds: int, report: Callable[[], None]) -> Progress:
        """Move vertices of the hull for so many rounds, or until nothing much moves; the record with the moves. report as progress."""
        alive = _alive(mesh)
        first = 0.0
        for _ in range(rounds):
            taken = 0.0
            for start in range(0, len(alive), PIECE):
                end = min(start + PIECE, len(alive))
                record = _with_room(record, end - start)
                step = int(record.counters[STEPS])
                moved, places, gains = np.empty(PIECE, np.int32), record.positions[step:], np.empty(PIECE)
                count = int(shrink(mesh, self._original, self._fit, alive, start, end, moved, places, gains))
                record.vertices[step : step + count, 0], record.vertices[step : step + count, 1] = moved[:count], MOVE
                record.volume[step : step + count] = -gains[:count]
                record.counters[STEPS] += count
                taken += float(gains[:count].sum())
                report()
            first = max(first, taken)
            if taken <= ENOUGH * first:
                break
        return record


def _alive(mesh: CollapseMesh) -> I4:
    """(n,) i4: vertices that the collapses have left."""
    ends = mesh.half[mesh.half >= 0]
    return np.unique(mesh.corner[np.concatenate([ends, mesh.opposite[ends]])]).astype(np.int32)


def _with_room(record: Progress, moves: int) -> Progress:
    """The record with room for so many moves beside the collapses that may still come."""
    needed = int(record.counters[STEPS]) + moves + len(record.target) // 3
    if needed <= len(record.vertices):
        return record
    size = needed + needed // 2
    grown = (np.resize(array, (size, *array.shape[1:])) for array in (record.vertices, record.positions, record.volume))
    return record._replace(**dict(zip(("vertices", "positions", "volume"), grown, strict=True)))
