"""How far a surface is from a mesh at most: the one-sided Hausdorff distance, with a certified upper bound.

The search is in `worker.kernels.level_distance`, with what its rounding can take away.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np

from geometry.boxes import build_boxes
from schemas.conventions import F4, F8, I4
from worker.kernels import level_distance
from worker.kernels.level_distance import CUTS_LEFT, HIGH, LOW

RUNGS = ((0.5, 1e-2), (0.1, 1e-3), (0.03, 1e-4))
"""(gap, floor): a bound may be above the distance by this part of it, or by so many normalised units where that is more. Roughly
first, which is cheap, and stands where the next takes too long: on flat parts of an original, cut along all of their inner edges.
A later one searches those faces only whose bounds are not yet as it wants them.
The floor of the last is a fifth of a pixel in an image of 4000."""
ROUGHLY = RUNGS[:2]
"""For what is only told, and decides nothing."""
CUTS, CUTS_A_FACE = 200_000, 4
"""Cuts, and more for each face of both meshes, after which a search gives up; scans need one or two a face."""
ROUNDING = 1e-12
"""Normalised units, and part of the distance, by which a computed bound can be short."""
_POINTS_A_CHUNK = 20_000  # some 0.1 s each: progress is also where a cancelled search stops
_FACES_A_CHUNK = 5_000


class Distance(NamedTuple):
    """Largest distance of a point of a surface from a mesh, normalised units: not less than `least`, not more than `bound`."""

    least: float
    bound: float


class DistanceTo:
    """A mesh that others are measured against. positions (v, 3) f4 in the normalised frame, faces (f, 3) i4."""

    def __init__(self, positions: F4, faces: I4) -> None:
        order, boxes = build_boxes(positions, faces)
        self._mesh = (positions, faces, order, boxes)

    def of(self, positions: F4, faces: I4, progress: Callable[[float], None], rungs: tuple[tuple[float, float], ...] = RUNGS) -> Distance:
        """Of the points of another surface, positions (n, 3) f4 and faces (m, 3) i4; all vertices must be used.

        rungs: as RUNGS, or the first of them.
        progress is called with a fraction 0 ... 1 several times a second; what it raises passes through.
        """
        state = np.zeros(3)
        closest, bounds = np.empty(len(positions), np.int32), np.full(len(faces), np.inf)
        for begin in range(0, len(positions), _POINTS_A_CHUNK):
            end = min(begin + _POINTS_A_CHUNK, len(positions))
            level_distance.nearest_faces(*self._mesh, positions, begin, end, closest, state)
            progress(0.2 * end / len(positions))
        bound = np.inf
        for k, rung in enumerate(rungs):
            start, share = 0.2 + 0.8 * k / len(rungs), 0.8 / len(rungs)
            for done in self._search(rung, (positions, faces, closest, bounds), state):
                progress(start + share * done)
            bound = min(bound, float(np.sqrt(state[HIGH])))
            if state[CUTS_LEFT] <= 0:
                break
        progress(1.0)
        return Distance(float(np.sqrt(state[LOW])), bound * (1.0 + ROUNDING) + ROUNDING)

    def _search(self, rung: tuple[float, float], surface: tuple[F4, I4, I4, F8], state: F8) -> Iterator[float]:
        """Bound all faces of a surface (positions, faces, closest, bounds) into state[HIGH], saying how much is done."""
        faces = surface[1]
        state[HIGH], state[CUTS_LEFT] = state[LOW], CUTS + CUTS_A_FACE * (len(faces) + len(self._mesh[1]))
        for begin in range(0, len(faces), _FACES_A_CHUNK):
            end = min(begin + _FACES_A_CHUNK, len(faces))
            level_distance.bound_faces(*self._mesh, *surface, begin, end, *rung, state)
            yield end / len(faces)
