"""The progressive hull: a sequence of edge collapses, each of which encloses the mesh before it, and of moves back inwards.

Based on: Sander, Gu, Gortler, Hoppe, Snyder, "Silhouette Clipping" (SIGGRAPH 2000), section 3. The kernels say what departs
from it: `worker.kernels.collapse_place` (placement), `worker.kernels.collapse` (order). Enclosure is that of the winding
number: at no point of space does a collapse lower it, decided exactly for the float32 vertices that are stored. Moves
(`worker.shrink`) bring vertices back as far as the original allows. On the mesh turned inside out the same construction gives
the inner hull, which the original encloses.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from geometry.hull_sequence import replay_steps, steps_to
from geometry.topology import build_edges, signed_volume
from schemas.conventions import F4, I4
from worker.kernels.collapse import COLLAPSES, CURSOR, DONE, FULL, GOING, STEPS, Progress, advance, new_progress
from worker.kernels.collapse_mesh import build_collapse_mesh
from worker.kernels.collapse_place import new_place
from worker.kernels.collapse_queue import empty_queue
from worker.kernels.load_collinear import collinear
from worker.shrink import ShrinkPass, Side, shrink_sizes

_PIECE = 20_000
"""Edges costed between two reports: about 0.05 s."""
UNREACHED_EXCESS = 0.25
"""Excess (of an inner hull: loss) at which a hull stops when its face count cannot be reached (many handles or components): the
last collapses before nothing moves any more make spikes several times the size of the original, for a count that is missed all
the same. It is shrunk there: a dragon of 400,000 faces stops at 2,240 with 16 %."""
_COSTING_PART = 0.05  # of the whole time goes into the first costs


@dataclass(frozen=True)
class Hull:
    """A hull and the sequence it was cut from.

    positions: (hv, 3) f4. faces: (hf, 3) i4, closed, oriented as the original. step_vertices (s, 2) i4, step_positions (s, 3) f4,
    level_faces (l,) i4 and level_steps (l,) i4: see `schemas.artifacts.HULL_SEQUENCE`. volume_excess: (volume of the hull -
    volume of the original) / volume of the original, volumes counted with the winding number; negative for an inner hull;
    infinite when something was gained (lost) on an original without volume.
    """

    positions: F4
    faces: I4
    step_vertices: I4
    step_positions: F4
    level_faces: I4
    level_steps: I4
    volume_excess: float


def build_hull(positions: F4, faces: I4, max_faces: int, progress: Callable[[float], None], side: Side = "outer") -> Hull:
    """Hull of at most max_faces faces of a closed oriented 2-manifold: one that encloses it, or, inner, that it encloses.

    Where topology (which is kept) does not let so few faces be reached, the hull is the one whose volume excess came to
    UNREACHED_EXCESS, shrunk; `len(hull.faces)` says how many. The sequence goes on to the end of what is possible either way.

    positions: (v, 3) f4. faces: (f, 3) i4. progress is called with a fraction 0 ... 1 several times a second; what it raises
    passes through.
    Raises geometry.topology.NotManifoldError when the mesh is not closed and consistently oriented.
    """
    points, triangles = np.ascontiguousarray(positions, np.float32), np.ascontiguousarray(faces, np.int32)
    outward = triangles if side == "outer" else np.ascontiguousarray(triangles[:, ::-1])
    volume = signed_volume(points, triangles)
    record, unreached = _collapse_all(points, outward, max_faces, UNREACHED_EXCESS * max(0.0, volume), side, progress)
    count = int(record.counters[STEPS])
    steps, places = record.vertices[:count].copy(), record.positions[:count].copy()
    reached = len(triangles) - 2 * int(record.counters[COLLAPSES]) <= max_faces
    level = steps_to(steps, len(triangles), max_faces) if reached else unreached
    level, hull_positions, hull_faces = _without_flat_faces(points, triangles, steps, places, level)
    gained = float(record.volume[:level].sum())
    excess = gained / volume if volume > 0.0 else (math.inf if gained > 0.0 else 0.0)
    level_faces, level_steps = np.array([len(hull_faces)], np.int32), np.array([level], np.int32)
    return Hull(hull_positions, hull_faces, steps, places, level_faces, level_steps, excess if side == "outer" else -excess)


def _without_flat_faces(points: F4, triangles: I4, steps: I4, places: F4, level: int) -> tuple[int, F4, I4]:
    """(steps, positions, faces) of the hull after `level` steps, or so many more that it has no face without area.

    Faces without area are left where the original has some and may keep more faces than it has.
    """
    first = level, *replay_steps(points, triangles, steps, places, level)
    hull, more = first, 1
    while collinear(*hull[1:]).any():
        if level + more > len(steps):
            return first
        hull = level + more, *replay_steps(points, triangles, steps, places, level + more)
        more *= 2
    return hull


def _collapse_all(
    points: F4, triangles: I4, max_faces: int, most_gained: float, side: Side, progress: Callable[[float], None]
) -> tuple[Progress, int]:
    """Collapse until nothing is left to collapse, with shrink passes on the way: at sizes, and when most_gained would be exceeded.

    Returns the record and after how many of its steps to stop where it does not come to max_faces.
    """
    edges = build_edges(triangles)
    mesh = build_collapse_mesh(points, triangles, edges.vertices, edges.faces)
    queue, place = empty_queue(len(edges.vertices)), new_place()
    record = new_progress(len(edges.vertices), len(triangles))
    shrinking = ShrinkPass(points, triangles, side)
    sizes = [*shrink_sizes(len(triangles), max_faces), 0]
    unreached, furthest = None, 0.0

    def report() -> None:
        nonlocal furthest
        costed = record.counters[CURSOR] / max(1, len(edges.vertices))
        collapsed = record.counters[COLLAPSES] / max(1, len(triangles) // 2)
        # after a shrink pass all edges are costed again: that is no step back
        furthest = max(furthest, float(_COSTING_PART * costed + (1.0 - _COSTING_PART) * collapsed))
        progress(furthest)

    state = GOING
    while state != DONE:
        state = advance(mesh, queue, record, place, _PIECE, sizes[0], most_gained)
        report()
        if state == GOING or (state == DONE and unreached is not None):
            continue
        if sizes[0] or state == FULL:
            record = shrinking.run(mesh, record, report)
            record.counters[CURSOR] = 0
        if state == FULL:
            most_gained, unreached = math.inf, int(record.counters[STEPS])
        else:
            del sizes[0]
    progress(1.0)
    return record, int(record.counters[STEPS]) if unreached is None else unreached
