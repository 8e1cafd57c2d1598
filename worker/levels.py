"""Silhouette levels for far views: hulls of several sizes, each with a certified distance from the original and a search tree.

Based on: Sander, Gu, Gortler, Hoppe, Snyder, "Silhouette Clipping" (SIGGRAPH 2000), section 7, which leaves silhouettes that are
adapted to the view as future work. A level encloses the original, so the original's shape in an image lies inside the level's;
and no point of the level is further from the original than its `bound`, so the level's shape is larger by no more than that looks.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from geometry.hull_sequence import cut_hull
from geometry.topology import build_edges, signed_volume
from schemas.artifacts import MOST_LEVELS
from schemas.conventions import F4, I4, Array
from worker.distance import RUNGS, DistanceTo
from worker.kernels.cones import FARTHEST_ANCHOR
from worker.tree import Tree, build_tree

FEWEST_LEVELS = 4
LEAST_FACES = 2000
"""Originals with fewer faces are as fast as their levels would be."""
USUAL_RATIO, LEAST_RATIO = 4.0, 2.0
"""Faces of a level over those of the next; silhouettes then have half (three quarters) of the edges."""


@dataclass(frozen=True)
class HullLevel:
    """A hull cut from a sequence. positions (v, 3) f4, faces (f, 3) i4; bound: no point of it is further than this from the original,
    normalised units. volume_excess: (its volume - the original's) / the original's; an inner hull's is negative.
    """

    positions: F4
    faces: I4
    bound: float
    volume_excess: float


@dataclass(frozen=True)
class SilhouetteLevel:
    """A level with what extraction needs: edge_vertices, edge_faces (e, 2) i4 as in `geometry.topology.EdgeTable`, and its tree."""

    hull: HullLevel
    edge_vertices: I4
    edge_faces: I4
    tree: Tree

    def tensors(self) -> dict[str, Array]:
        """The tensors of `schemas.artifacts.LEVELS`; the tree has its own."""
        hull, bound = self.hull, np.array([self.hull.bound])
        edges = {"edge_vertices": self.edge_vertices, "edge_faces": self.edge_faces}
        return {"positions": hull.positions, "faces": hull.faces, **edges, "bound": bound}


def level_sizes(faces: int, hull_faces: int) -> list[int]:
    """Face counts of the levels of a mesh of so many faces, finest first, down to its drawn hull's; none for small meshes.

    They fall by the same ratio, about USUAL_RATIO, but are FEWEST_LEVELS to MOST_LEVELS, or fewer where they would lie closer than
    LEAST_RATIO.
    """
    span = faces / max(hull_faces, 4)
    if faces < LEAST_FACES or span < LEAST_RATIO:
        return []
    count = min(max(round(math.log(span, USUAL_RATIO)), FEWEST_LEVELS), MOST_LEVELS, int(math.log(span, LEAST_RATIO)))
    return [round(faces / span ** (k / count)) for k in range(1, count)] + [hull_faces]


def hull_levels(
    positions: F4,
    faces: I4,
    steps: tuple[I4, F4],
    sizes: list[int],
    progress: Callable[[float], None],
    rungs: tuple[tuple[float, float], ...] = RUNGS,
) -> list[HullLevel]:
    """Hulls of at most so many faces each, with their distances from the original.

    positions (v, 3) f4, faces (f, 3) i4: the original; steps: step_vertices and step_positions of one of its sequences. Hulls that
    reach so far out that nothing can be proved of them are left out. progress and rungs as in `worker.distance`.
    """
    if not sizes:
        return []
    original, volume = DistanceTo(positions, faces), signed_volume(positions, faces)
    made = []
    for k, size in enumerate(sizes):
        hull_positions, hull_faces = cut_hull(positions, faces, *steps, size)
        if not np.all(np.abs(hull_positions) <= FARTHEST_ANCHOR):
            continue

        def report(part: float, k: int = k) -> None:
            progress((k + part) / len(sizes))

        distance = original.of(hull_positions, hull_faces, report, rungs)
        gained = signed_volume(hull_positions, hull_faces) - volume
        made.append(HullLevel(hull_positions, hull_faces, distance.bound, gained / volume if volume > 0.0 else 0.0))
    return made


def build_levels(
    positions: F4, faces: I4, steps: tuple[I4, F4], hull_faces: int, progress: Callable[[float], None]
) -> list[SilhouetteLevel]:
    """The silhouette levels of a mesh whose drawn hull has hull_faces faces, finest first; parameters as in `hull_levels`."""
    sizes = level_sizes(len(faces), hull_faces)
    hulls = hull_levels(positions, faces, steps, sizes, lambda part: progress(0.5 * part))
    return silhouette_levels(hulls, lambda part: progress(0.5 + 0.5 * part))


def silhouette_levels(hulls: list[HullLevel], progress: Callable[[float], None]) -> list[SilhouetteLevel]:
    """Levels with their edges and trees."""
    total, done, made = sum(len(hull.faces) for hull in hulls), 0, []
    for hull in hulls:
        edges, (start, share) = build_edges(hull.faces), (done / total, len(hull.faces) / total)

        def report(part: float, start: float = start, share: float = share) -> None:
            progress(start + share * part)

        tree = build_tree(hull.positions, hull.faces, edges.vertices, edges.faces, report)
        made.append(SilhouetteLevel(hull, edges.vertices, edges.faces, tree))
        done += len(hull.faces)
    progress(1.0)
    return made
