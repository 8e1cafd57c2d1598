"""Checks of the hulls of other sizes, as stored: they enclose the original, or it them, and are no further from it than they say."""

from __future__ import annotations

from typing import Any

import numpy as np

from geometry.hull_sequence import replay_steps
from schemas.conventions import F4, F8, I4
from schemas.errors import CorruptArtifactError
from worker.enclosure import NotEnclosedError, Solid, UnprovenError, fault_between
from worker.kernels import bake_boxes
from worker.verify import Tensors, check_edges, check_surface, check_tree

SAMPLES = 20_000
"""Points of a level at which its distance from the original is looked up."""
SLACK = 1e-12
"""Normalised units that looking up may be off."""


def verify_level(original: Solid, level: Tensors, tree: Tensors) -> dict[str, Any]:
    """Check a level and its tree: tensors of `schemas.artifacts.LEVELS` and `LEVEL_TREES`.

    Returns {faces, bound, farthest: of the sampled points, grazing_points}. Raises CorruptArtifactError.
    """
    positions, faces, bound = level["positions"], level["faces"], float(level["bound"][0])
    check_surface(level, "level")
    check_edges(level)
    check_tree(level, tree)
    grazing = _enclosed(original, Solid(positions, faces), "level")
    farthest = _farthest(original, sampled_points(positions, faces, SAMPLES))
    if not farthest <= bound + SLACK:
        raise CorruptArtifactError("a level is further from the original than it says", artifact="level", distance=farthest, bound=bound)
    return {"faces": len(faces), "bound": bound, "farthest": farthest, "grazing_points": grazing}


def verify_inner(original: Solid, sequence: Tensors) -> dict[str, Any]:
    """Check that the original encloses the finest and the coarsest of the hulls that an inner sequence was shrunk for.

    sequence: tensors of `schemas.artifacts.INNER_SEQUENCE`. Returns {faces: of the checked hulls, grazing_points}. Raises
    CorruptArtifactError.
    """
    vertices, places = sequence["step_vertices"], sequence["step_positions"]
    counts, grazing = [], 0
    if not len(sequence["level_steps"]):
        raise CorruptArtifactError("an inner sequence has no hull", artifact="inner")
    for steps in sorted({int(steps) for steps in sequence["level_steps"][[0, -1]]}):
        if not 0 <= steps <= len(vertices):
            raise CorruptArtifactError("an inner hull has steps that are not there", artifact="inner", steps=steps)
        hull = Solid(*replay_steps(original.positions, original.faces, vertices, places, steps))
        check_surface({"positions": hull.positions, "faces": hull.faces}, "inner hull")
        grazing += _enclosed(hull, original, "inner")
        counts.append(len(hull.faces))
    return {"faces": counts, "grazing_points": grazing}


def _enclosed(inside: Solid, outside: Solid, artifact: str) -> int:
    try:
        return fault_between(inside, outside)
    except NotEnclosedError as fault:
        message = f"the {artifact} hull is wrong: {fault}"
        raise CorruptArtifactError(message, artifact=artifact, distance=fault.distance, point=fault.point) from fault
    except UnprovenError as fault:
        raise CorruptArtifactError(f"the {artifact} hull is wrong: {fault}", artifact=artifact) from fault


def sampled_points(positions: F4, faces: I4, count: int) -> F8:
    """(n, 3) f8: all vertices, or `count` of them, and `count` points spread evenly over the surface; the same every time."""
    rng = np.random.default_rng(20000723)
    corners = positions[faces].astype(np.float64)
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    ends = np.cumsum(area)
    face = np.minimum(np.searchsorted(ends, rng.uniform(0.0, ends[-1], count), side="right"), len(faces) - 1)
    weights = rng.dirichlet(np.ones(3), count)
    on_faces = np.einsum("nk,nki->ni", weights, corners[face])
    vertices = positions if len(positions) <= count else rng.choice(positions, count, replace=False)
    return np.concatenate([vertices.astype(np.float64), on_faces])


def _farthest(original: Solid, points: F8) -> float:
    _, _, square = bake_boxes.closest_points(original.positions, original.faces, original.order, original.boxes, points)
    return float(np.sqrt(square.max()))
