"""Part of `benchmarks.exactness`: what deciding doubtful faces exactly costs the walk of a silhouette tree.

The walk without it is the same code compiled once more, with one function replaced: a leaf's faces get the sign of their height in
float32, none is doubtful, and the compiler drops what would settle them. Its results may be wrong; only its time counts.
"""

from __future__ import annotations

import time
from types import FunctionType
from typing import Any

import numpy as np
from numba import njit

from benchmarks.extraction import random_eyes, read, silent
from benchmarks.report import Result
from schemas.conventions import F8
from service.kernels import tree_walk
from service.kernels.tree_walk import (
    COUNTS,
    EDGES_BITS,
    FLIPPED,
    HEAD_WORDS,
    LINE,
    MORE_BIT,
    TURN_BITS,
    VERTICES_BITS,
    open_nodes,
    sure_sides,
    turned_eyes,
)
from service.kernels.tree_walk_leaf import face_sides, leaf_eye, ones
from service.kernels.tree_walk_pack_leaves import leaf_words
from service.silhouette.extract import SilhouetteTree
from worker.tree import build_tree

MESHES = ("bunny_closed", "dragon_400k", "dragon_871k", "armadillo_86k", "knot", "holes3")
BAR = 1.05
"""Of the time without exactness."""


@njit(inline="always")
def _float_sides(arena, at, counts, eyes):  # noqa: ANN001, ANN202
    """As `tree_walk.leaf_sides`, every face by its sign in float32."""
    base, b, c, d = leaf_eye(arena, at, eyes, (counts >> TURN_BITS) & 3)
    row = (((counts & 0xFF) + 7) >> 3) << 2
    over, _ = face_sides(arena, at + HEAD_WORDS, row, base, b, c, d)
    return over ^ tree_walk._word_of(arena, at + FLIPPED), False


def _compiled_with(kernel: Any, **replaced: Any) -> Any:
    """The kernel compiled once more, with other functions in the place of those that it calls by these names."""
    plain = kernel.py_func
    return njit(nogil=True)(FunctionType(plain.__code__, plain.__globals__ | replaced, plain.__name__))


def walks() -> tuple[Any, Any]:
    """(the walk, the walk without exactness), both compiled here and alike but for `leaf_sides`."""
    exact = _compiled_with(tree_walk.find_edges, visit_leaves=_compiled_with(tree_walk.visit_leaves))
    leaves = _compiled_with(tree_walk.visit_leaves, leaf_sides=_float_sides)
    return exact, _compiled_with(tree_walk.find_edges, visit_leaves=leaves)


@njit(nogil=True)
def count_sides(arena, leaves, eyes):  # noqa: ANN001, ANN201
    """(faces tested, faces among them that are decided exactly) in the leaves that `open_nodes` found."""
    tested, doubtful = 0, 0
    for leaf in leaves:
        at = LINE * np.intp(arena[leaf])
        more = True
        while more:
            counts = arena[at + COUNTS]
            _, unsure = sure_sides(arena, at, counts, eyes)
            tested, doubtful = tested + (counts & 0xFF), doubtful + ones(unsure)
            more = (counts >> MORE_BIT) != 0
            at += leaf_words(counts & 0xFF, (counts >> EDGES_BITS) & 0xFF, (counts >> VERTICES_BITS) & 0xFF)
    return tested, doubtful


def _nanoseconds(walk: Any, arguments: tuple[Any, ...], eye: F8, farthest: float) -> int:
    begun = time.perf_counter_ns()
    walk(*arguments, eye, farthest)
    return time.perf_counter_ns() - begun


def interleaved(exact: Any, unfiltered: Any, arguments: tuple[Any, ...], eyes: F8, farthest: float, seconds: float) -> F8:
    """(2, eyes) f8 median microseconds an eye, of the one and the other in turn, in both orders, for so many seconds."""
    rounds = []
    until = time.perf_counter() + seconds
    while len(rounds) < 4 or time.perf_counter() < until:
        times = np.empty((2, len(eyes)))
        for i, eye in enumerate(eyes):
            # an own round in front: both then find in the caches what the other left there
            for k in (0, 1) if (i + len(rounds)) % 2 else (1, 0):
                times[k, i] = _nanoseconds((exact, unfiltered)[k], arguments, eye, farthest)
        rounds.append(times)
    return np.asarray(np.median(np.array(rounds), axis=0) / 1e3)


def measure(name: str, views: int, seconds: float, both: tuple[Any, Any]) -> Result:
    """The row of a mesh: microseconds of both walks, their ratio, and how many faces of a view are decided exactly."""
    positions, faces, edges = read(name)
    mesh = {"positions": positions, "faces": faces, "edge_vertices": edges.vertices, "edge_faces": edges.faces}
    tree = SilhouetteTree(mesh, build_tree(positions, faces, edges.vertices, edges.faces, silent).tensors())
    arena, lanes, scratch = tree._arena, tree._lanes, tree._scratch.words
    arguments = (arena, scratch, lanes, tree.positions)
    eyes = random_eyes(views, 0)
    sides = []
    for eye in eyes:
        turned = turned_eyes(eye)
        leaves, _ = open_nodes(arena, scratch, lanes, eye, tree._farthest_anchor)
        sides.append(count_sides(arena, leaves, turned))
    tested, doubtful = np.mean(sides, axis=0)
    times = interleaved(*both, arguments, eyes, tree._farthest_anchor, seconds)
    return {
        "mesh": name,
        "faces": len(faces),
        "exact_us": round(float(np.median(times[0])), 2),
        "float_us": round(float(np.median(times[1])), 2),
        "ratio": round(float(np.median(times[0] / times[1])), 4),
        "faces_tested": round(float(tested), 1),
        "faces_decided_exactly": round(float(doubtful), 2),
    }
