"""Runtime silhouette extraction: a search tree packed once, then a few thousand tests an eye.

Based on: Silhouette Clipping, section 5. The result is the same set of directed edges as `geometry.silhouettes`, for every
eye; how the walk departs from the paper is said in `service.kernels.tree_walk` and `service.silhouette.packing`.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from concurrent.futures import Future
from typing import NamedTuple, TypeVar

import numpy as np
import numpy.typing as npt

from geometry.silhouettes import silhouette_scalar
from schemas.conventions import F4, F8, I4, Array
from service.kernels import tree_walk
from service.silhouette.packing import check_tree, pack_tree
from service.threads import pool

T = TypeVar("T", bound=np.generic)
_WALK: Callable[..., tuple[I4, int, int]] = tree_walk.walk
_TOO_FAR = -1
_LEAVES_A_THREAD = 1500
"""Fewer are not worth waking a thread for: some 0.1 ms."""
_EDGES_TO_SHARE = 400_000
"""Meshes with fewer have fewer leaves to test than that for any eye worth drawing."""


class Extraction(NamedTuple):
    """Silhouette of one eye: edges (s, 2) i4 directed vertex pairs, and what finding them took."""

    edges: I4
    tested_edges: int
    tested_nodes: int


class _Scratch(threading.local):
    """Queues and output of one thread, so that calls allocate nothing but their result and threads do not meet."""

    def __init__(self, words: int) -> None:
        self.words: I4 = np.empty(words, np.int32)


class SilhouetteTree:
    """A mesh and its search tree, ready for any number of threads.

    mesh, tree: tensors of `schemas.artifacts.MESH` and `TREE`. Raises CorruptArtifactError when the tree is not one of this
    mesh: indices out of range, or an edge that is not in exactly one node.
    """

    def __init__(self, mesh: Mapping[str, Array], tree: Mapping[str, Array]) -> None:
        check_tree(mesh, tree)
        self.positions: F4 = frozen(mesh["positions"], np.float32)
        self.faces: I4 = frozen(mesh["faces"], np.int32)
        self.edge_vertices: I4 = frozen(mesh["edge_vertices"], np.int32)
        self.edge_faces: I4 = frozen(mesh["edge_faces"], np.int32)
        anchors = np.concatenate([tree["front_anchor"], tree["back_anchor"]]).astype(np.float64)
        self._farthest_anchor = max(1.0, float(np.sqrt((anchors**2).sum(axis=1)).max(initial=0.0)))
        self._arena, self._lanes = pack_tree(self.positions, self.faces, self.edge_vertices, self.edge_faces, tree)
        self._scratch = _Scratch(2 * self._lanes + 2 * (len(self.edge_vertices) + tree_walk.SPARE_EDGES))

    def extract(self, eye: F8, threads: int = 1) -> Extraction:
        """Silhouette for a homogeneous eye (4,) f8 in the normalised frame (`schemas.conventions`).

        threads: how many may share the leaves, where the mesh is so large that it pays; the edges are the same, in some order.
        Raises ValueError when the eye is not finite or its last coordinate is neither 1 nor 0.
        """
        eye = np.ascontiguousarray(eye, np.float64)
        if eye.shape != (4,) or not _are_eyes(*eye.tolist()):
            raise ValueError("an eye is four finite numbers, the last one 1 or 0")
        if threads > 1 and len(self.edge_vertices) >= _EDGES_TO_SHARE:
            return self.share_leaves(eye, threads)
        edges, tested, cones = _WALK(self._arena, self._scratch.words, self._lanes, self.positions, eye, self._farthest_anchor)
        return self._by_brute_force(eye) if tested == _TOO_FAR else Extraction(edges, tested, cones)

    def extract_many(self, eyes: F8, threads: int = 1) -> list[Extraction]:
        """Silhouettes for eyes (k, 4) f8 in one call, each as `extract` finds it; threads share the eyes.

        Raises ValueError as `extract` does.
        """
        eyes = np.ascontiguousarray(eyes, np.float64)
        if eyes.ndim != 2 or eyes.shape[1] != 4 or not all(_are_eyes(*eye) for eye in eyes.tolist()):
            raise ValueError("eyes are rows of four finite numbers, the last one 1 or 0")
        parts = [part for part in np.array_split(eyes, max(1, threads)) if len(part)]
        others = [pool().submit(self._walk_many, part) for part in parts[1:]]
        found = self._walk_many(parts[0]) if parts else []
        return found + [extraction for other in others for extraction in other.result()]

    def _walk_many(self, eyes: F8) -> list[Extraction]:
        edges, numbers = tree_walk.walk_many(self._arena, self._scratch.words, self._lanes, self.positions, eyes, self._farthest_anchor)
        found, begin = [], 0
        for eye, (count, tested, cones) in zip(eyes, numbers.tolist(), strict=True):
            end = begin + count
            found.append(self._by_brute_force(eye) if tested == _TOO_FAR else Extraction(edges[begin:end], tested, cones))
            begin = end
        return found

    def share_leaves(self, eye: F8, threads: int) -> Extraction:
        """As `extract`, the leaves shared out to threads, this one among them, however large the mesh. eye (4,) f8 is checked already."""
        eyes: F4 = tree_walk.turned_eyes(eye)
        if not eyes.any():
            return self._by_brute_force(eye)
        words = self._scratch.words
        leaves, cones = tree_walk.open_nodes(self._arena, words, self._lanes, eye, self._farthest_anchor)
        parts = np.array_split(leaves, max(1, min(threads, len(leaves) // _LEAVES_A_THREAD)))
        others: list[Future[tuple[I4, int]]] = [pool().submit(self._test_leaves, part, eye, eyes) for part in parts[1:]]
        found = [self._test_leaves(parts[0], eye, eyes), *(other.result() for other in others)]
        edges = found[0][0] if len(found) == 1 else np.concatenate([edges for edges, _ in found])
        return Extraction(edges, sum(tested for _, tested in found), cones)

    def _test_leaves(self, leaves: I4, eye: F8, eyes: F4) -> tuple[I4, int]:
        if not len(leaves):
            return np.empty((0, 2), np.int32), 0
        waiting, out = self._scratch.words[: self._lanes], self._scratch.words[2 * self._lanes :]
        count, tested = tree_walk.visit_leaves(self._arena, leaves, waiting, self.positions, eye, eyes, out)
        return tree_walk.as_edges(out, count), tested

    def _by_brute_force(self, eye: F8) -> Extraction:
        edges = silhouette_scalar(self.positions, self.faces, self.edge_vertices, self.edge_faces, eye)
        return Extraction(edges, len(self.edge_vertices), 0)


def _are_eyes(x: float, y: float, z: float, w: float) -> bool:
    return (w in (0.0, 1.0)) and (x - x) + (y - y) + (z - z) == 0.0  # not a number minus itself, nor infinity, is no zero


def frozen(values: Array, kind: type[T]) -> npt.NDArray[T]:
    """Contiguous and read-only, as a mapped artifact is: one array type for the compiler wherever the mesh comes from."""
    view = np.ascontiguousarray(values, kind).view()
    view.flags.writeable = False
    return view
