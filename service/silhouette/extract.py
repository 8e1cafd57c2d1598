"""Runtime silhouette extraction: a search tree packed once, then a few thousand tests an eye.

Based on: Silhouette Clipping, section 5. The result is the same set of directed edges as `geometry.silhouettes`, for every
eye; how the walk departs from the paper is said in `service.kernels.tree_walk` and `service.kernels.tree_walk_pack`.
"""

from __future__ import annotations

import threading
from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from geometry.silhouettes import PLANE_ERROR, face_planes, silhouette_scalar
from schemas.conventions import F4, F8, I4, U1, Array
from schemas.errors import CorruptArtifactError
from service.kernels import tree_walk, tree_walk_pack
from service.kernels.tree_walk_lanes import EDGE_ROWS, LANES, NODE_ROWS

_FARTHEST_EYE = 1e14
"""Normalised units: beyond, squares of scaled normals times the eye could overflow float32; such eyes are brute force."""
_AT_INFINITY = np.float32(1e-30)


class Extraction(NamedTuple):
    """Silhouette of one eye: edges (s, 2) i4 directed vertex pairs, and what finding them took."""

    edges: I4
    tested_edges: int
    tested_nodes: int


@dataclass(frozen=True)
class _Packed:
    """Blocks of the walk; see the kernels for every array."""

    nodes: F4
    below: I4
    guarded: I4
    parents: U1
    guards: U1
    next_block: I4
    nodes_used: I4
    planes: F4
    more: I4
    edges_used: I4
    lane_edge: I4
    lane_vertices: I4


class _Scratch(threading.local):
    """Queues of one thread, so that calls allocate nothing but their result and threads do not meet."""

    def __init__(self, node_blocks: int, edge_blocks: int) -> None:
        self.queue = np.empty((node_blocks + 1) * LANES, np.int32)
        self.edge_queue = np.empty((node_blocks + 1) * LANES, np.int32)
        self.chosen = np.empty((edge_blocks + 1) * LANES, np.int32)


class SilhouetteTree:
    """A mesh and its search tree, ready for any number of threads.

    mesh, tree: tensors of `schemas.artifacts.MESH` and `TREE`. Raises CorruptArtifactError when the tree is not one of this
    mesh: indices out of range, or an edge that is not in exactly one node.
    """

    def __init__(self, mesh: Mapping[str, Array], tree: Mapping[str, Array]) -> None:
        _check(mesh, tree)
        self.positions: F4 = np.ascontiguousarray(mesh["positions"], np.float32)
        self.faces: I4 = np.ascontiguousarray(mesh["faces"], np.int32)
        self.edge_vertices: I4 = np.ascontiguousarray(mesh["edge_vertices"], np.int32)
        self.edge_faces: I4 = np.ascontiguousarray(mesh["edge_faces"], np.int32)
        planes = face_planes(self.positions, self.faces)
        self._farthest_plane = planes.farthest
        anchors = np.concatenate([tree["front_anchor"], tree["back_anchor"]]).astype(np.float64)
        self._farthest_anchor = max(1.0, float(np.sqrt((anchors**2).sum(axis=1)).max(initial=0.0)))
        self._packed = _pack(tree, self.edge_vertices, self.edge_faces, (planes.x, planes.y, planes.z, planes.d))
        self._scratch = _Scratch(len(self._packed.next_block), len(self._packed.more))

    def extract(self, eye: F8) -> Extraction:
        """Silhouette for a homogeneous eye (4,) f8 in the normalised frame (`schemas.conventions`).

        Raises ValueError when the eye is not finite or its last coordinate is neither 1 nor 0.
        """
        eye = np.ascontiguousarray(eye, np.float64)
        if eye.shape != (4,) or not np.isfinite(eye).all() or eye[3] not in (0.0, 1.0):
            raise ValueError("an eye is four finite numbers, the last one 1 or 0")
        length = float(np.sqrt(eye[0] * eye[0] + eye[1] * eye[1] + eye[2] * eye[2]))
        at_infinity = eye[3] == 0.0
        if not length < _FARTHEST_EYE or (at_infinity and length < 1e-100):
            edges = silhouette_scalar(self.positions, self.faces, self.edge_vertices, self.edge_faces, eye)
            return Extraction(edges, len(self.edge_vertices), 0)
        if at_infinity:
            eye4 = (eye / length).astype(np.float32)
            return self._walk(eye, eye4, 1.0, _AT_INFINITY)
        return self._walk(eye, eye.astype(np.float32), length, np.float32(1.0))

    def _walk(self, eye: F8, eye4: F4, length: float, w_back: np.float32) -> Extraction:
        p, scratch, w = self._packed, self._scratch, float(eye[3])
        margin = np.float32(tree_walk.CONE_ERROR * (length + w * self._farthest_anchor))
        found, nodes = tree_walk.visit_nodes(
            p.nodes, p.below, p.guarded, p.parents, p.guards, p.next_block, p.nodes_used, eye4, w_back, margin,
            scratch.queue, scratch.edge_queue,
        )  # fmt: skip
        bound = np.float32(PLANE_ERROR * (1.7320508075688774 * length + w * self._farthest_plane) + 1e-30)
        count, edges = tree_walk.visit_edges(
            p.planes, p.guarded, p.more, p.edges_used, p.lane_edge, self.positions, self.faces, self.edge_faces, eye, eye4, bound,
            scratch.edge_queue, found, scratch.chosen,
        )  # fmt: skip
        return Extraction(tree_walk.collect(scratch.chosen, count, p.lane_vertices), edges, nodes)


def _check(mesh: Mapping[str, Array], tree: Mapping[str, Array]) -> None:
    """Refuse what the kernels could not index safely."""
    nodes, edges = len(tree["skip"]), len(mesh["edge_vertices"])
    ids = np.arange(nodes)
    start = tree["edge_start"]
    sound = (
        edges > 0
        and len(mesh["edge_faces"]) == edges
        and len(start) == nodes + 1
        and start[0] == 0
        and start[-1] == edges
        and bool(np.all(np.diff(start) >= 0))
        and bool(np.all((tree["skip"] > ids) & (tree["skip"] <= nodes)))
        and np.array_equal(np.sort(tree["edge_index"]), np.arange(edges))
        and all(np.all(np.isfinite(tree[name])) for name in ("scaled_normal", "front_anchor", "back_anchor", "separation"))
    )
    if not sound:
        raise CorruptArtifactError("the search tree does not belong to this mesh")


def _pack(tree: Mapping[str, Array], edge_vertices: I4, edge_faces: I4, planes: tuple[F4, F4, F4, F4]) -> _Packed:
    skip, edge_start = np.ascontiguousarray(tree["skip"]), np.ascontiguousarray(tree["edge_start"])
    n = len(skip)
    item, below = np.empty((n + 1, LANES), np.int32), np.empty((n + 1, LANES), np.int32)
    next_block = np.empty(n + 1, np.int32)
    blocks = tree_walk_pack.group(skip, edge_start, tree["scaled_normal"], item, below, next_block)
    item = item[:blocks].copy()
    nodes = np.empty((blocks, NODE_ROWS, LANES), np.float32)
    tree_walk_pack.pack_nodes(item, tree["scaled_normal"], tree["front_anchor"], tree["back_anchor"], tree["separation"], nodes)
    none2, none1 = np.empty((0, LANES), np.int32), np.empty(0, np.int32)
    count = tree_walk_pack.pack_edges(item, edge_start, tree["edge_index"], none2, none2, none1, none1)
    guarded, lane_edge = np.empty((blocks, LANES), np.int32), np.empty((count, LANES), np.int32)
    more, used = np.empty(count, np.int32), np.empty(count, np.int32)
    tree_walk_pack.pack_edges(item, edge_start, tree["edge_index"], guarded, lane_edge, more, used)
    packed, vertices = np.empty((count, EDGE_ROWS, LANES), np.float32), np.empty((count * LANES, 2), np.int32)
    tree_walk_pack.pack_planes(lane_edge, edge_vertices, edge_faces, *planes, packed, vertices)
    return _Packed(
        nodes=nodes.ravel(),
        below=below[:blocks].ravel(),
        guarded=guarded.ravel(),
        parents=np.packbits(below[:blocks] >= 0, axis=1, bitorder="little").ravel(),
        guards=np.packbits(guarded >= 0, axis=1, bitorder="little").ravel(),
        next_block=next_block[:blocks].copy(),
        nodes_used=(item >= 0).sum(axis=1).astype(np.int32),
        planes=packed.ravel(),
        more=more,
        edges_used=used,
        lane_edge=lane_edge.ravel(),
        lane_vertices=vertices,
    )
