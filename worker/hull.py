"""The progressive hull: a sequence of edge collapses whose every mesh encloses the one before it.

Based on: Sander, Gu, Gortler, Hoppe, Snyder, "Silhouette Clipping" (SIGGRAPH 2000), section 3. The kernels say what departs
from it: `worker.kernels.collapse_place` (placement), `worker.kernels.collapse` (order). Enclosure is that of the winding
number: at no point of space does a collapse lower it, decided exactly for the float32 vertices that are stored.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from geometry.topology import build_edges, signed_volume
from schemas.conventions import F4, I4
from worker.kernels.collapse import COLLAPSES, CURSOR, Progress, advance, new_progress
from worker.kernels.collapse_mesh import build_collapse_mesh
from worker.kernels.collapse_place import new_place
from worker.kernels.collapse_queue import empty_queue
from worker.kernels.collapse_replay import replay

_PIECE = 20_000
"""Edges costed between two reports: about 0.05 s."""
UNREACHED_EXCESS = 0.25
"""Excess at which a hull stops when its face count cannot be reached (many handles or components): the last collapses before
nothing moves any more make spikes several times the size of the original, for a count that is missed all the same."""
_COSTING_PART = 0.05  # of the whole time goes into the first costs


@dataclass(frozen=True)
class Hull:
    """A hull and the sequence it was cut from.

    positions: (hv, 3) f4. faces: (hf, 3) i4, closed, oriented as the original. collapse_vertices: (c, 2) i4 and
    collapse_positions: (c, 3) f4, see `schemas.artifacts.HULL_SEQUENCE`. volume_excess: (volume of the hull - volume of the
    original) / volume of the original, volumes counted with the winding number; infinite when something was gained on
    an original without volume.
    """

    positions: F4
    faces: I4
    collapse_vertices: I4
    collapse_positions: F4
    volume_excess: float


def build_hull(positions: F4, faces: I4, max_faces: int, progress: Callable[[float], None]) -> Hull:
    """Hull of at most max_faces faces of a closed oriented 2-manifold.

    Where topology (which is kept) does not let so few faces be reached, the hull has the fewest whose volume excess is at
    most UNREACHED_EXCESS; `len(hull.faces)` says how many. The sequence goes on to the end of what is possible either way.

    positions: (v, 3) f4. faces: (f, 3) i4. progress is called with a fraction 0 ... 1 several times a second; what it raises
    passes through.
    Raises geometry.topology.NotManifoldError when the mesh is not closed and consistently oriented.
    """
    points, triangles = np.ascontiguousarray(positions, np.float32), np.ascontiguousarray(faces, np.int32)
    record = _collapse_all(points, triangles, progress)
    count = int(record.counters[COLLAPSES])
    vertices, places = record.vertices[:count].copy(), record.positions[:count].copy()
    volume = signed_volume(points, triangles)
    gained = np.concatenate([[0.0], np.cumsum(record.volume[:count])])
    excess = gained / volume if volume > 0.0 else np.where(gained > 0.0, np.inf, 0.0)
    steps = _steps_to(len(triangles), max_faces)
    if steps > count:
        steps = int(np.searchsorted(excess, UNREACHED_EXCESS, side="right")) - 1
    hull_positions, hull_faces = cut_hull(points, triangles, vertices, places, len(triangles) - 2 * steps)
    return Hull(hull_positions, hull_faces, vertices, places, float(excess[steps]))


def _steps_to(face_count: int, max_faces: int) -> int:
    """Collapses, of two faces each, from face_count to at most max_faces."""
    return max(0, (face_count - max_faces + 1) // 2)


def _collapse_all(points: F4, triangles: I4, progress: Callable[[float], None]) -> Progress:
    """Collapse until nothing is left to collapse."""
    edges = build_edges(triangles)
    mesh = build_collapse_mesh(points, triangles, edges.vertices, edges.faces)
    queue, place = empty_queue(len(edges.vertices)), new_place()
    record = new_progress(len(edges.vertices), len(triangles))
    going = True
    while going:
        going = bool(advance(mesh, queue, record, place, _PIECE))
        costed = record.counters[CURSOR] / max(1, len(edges.vertices))
        collapsed = record.counters[COLLAPSES] / max(1, len(triangles) // 2)
        progress(float(_COSTING_PART * costed + (1.0 - _COSTING_PART) * collapsed))
    progress(1.0)
    return record


def cut_hull(positions: F4, faces: I4, collapse_vertices: I4, collapse_positions: F4, max_faces: int) -> tuple[F4, I4]:
    """Replay a sequence on its original until at most max_faces faces are left, or to its end.

    Returns (positions (hv, 3) f4, faces (hf, 3) i4) without unused vertices; vertices and faces keep the original's order.
    """
    steps = min(len(collapse_vertices), _steps_to(len(faces), max_faces))
    moved = np.array(positions, np.float32)
    merged = replay(moved, np.asarray(collapse_vertices, np.int32), np.asarray(collapse_positions, np.float32), steps)
    kept = merged[np.asarray(faces, np.int32)]
    kept = kept[(kept[:, 0] != kept[:, 1]) & (kept[:, 1] != kept[:, 2]) & (kept[:, 2] != kept[:, 0])]
    used = np.zeros(len(moved), np.bool_)
    used[kept] = True
    number = np.cumsum(used, dtype=np.int32) - 1
    return moved[used], np.ascontiguousarray(number[kept], np.int32)
