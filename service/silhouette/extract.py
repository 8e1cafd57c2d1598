"""Runtime silhouette extraction: a search tree packed once, then a few thousand tests an eye.

Based on: Silhouette Clipping, section 5. The result is the same set of directed edges as `geometry.silhouettes`, for every
eye; how the walk departs from the paper is said in `service.kernels.tree_walk` and `service.kernels.tree_walk_pack`.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Mapping
from typing import NamedTuple, TypeVar

import numpy as np
import numpy.typing as npt

from geometry.silhouettes import PLANE_ERROR, face_planes, silhouette_scalar
from schemas.conventions import F4, F8, I4, Array
from schemas.errors import CorruptArtifactError
from service.kernels import tree_walk, tree_walk_coarsen, tree_walk_pack
from service.kernels.tree_walk_lanes import LANES, NODE_ROWS

_FARTHEST_EYE = 1e14
"""Normalised units: beyond, squares of scaled normals times the eye could overflow float32; such eyes are brute force."""
_WALK: Callable[..., tuple[I4, int, int]] = tree_walk.walk
_CONES = ("scaled_normal", "front_anchor", "back_anchor", "separation")
T = TypeVar("T", bound=np.generic)
_SHORTEST_DIRECTION = 1e-100
_AT_INFINITY = 1e-30  # stands for the fourth coordinate where a separation counts: 3e38 still keeps every eye out
_SQRT_3 = 1.7320508075688774


class Extraction(NamedTuple):
    """Silhouette of one eye: edges (s, 2) i4 directed vertex pairs, and what finding them took."""

    edges: I4
    tested_edges: int
    tested_nodes: int


class _Scratch(threading.local):
    """Queues of one thread, so that calls allocate nothing but their result and threads do not meet."""

    def __init__(self, node_blocks: int, edge_lanes: int) -> None:
        lanes = (node_blocks + 1) * LANES
        self.queues = tree_walk.Queues(
            nodes=np.empty(lanes, np.int32),
            leaves=np.empty(lanes, np.int32),
            chosen=np.empty(edge_lanes + LANES, np.int32),
            turned=np.empty(edge_lanes // LANES, np.uint8),
        )


class SilhouetteTree:
    """A mesh and its search tree, ready for any number of threads.

    mesh, tree: tensors of `schemas.artifacts.MESH` and `TREE`. Raises CorruptArtifactError when the tree is not one of this
    mesh: indices out of range, or an edge that is not in exactly one node.
    """

    def __init__(self, mesh: Mapping[str, Array], tree: Mapping[str, Array]) -> None:
        _check(mesh, tree)
        self.positions: F4 = _frozen(mesh["positions"], np.float32)
        self.faces: I4 = _frozen(mesh["faces"], np.int32)
        self.edge_vertices: I4 = _frozen(mesh["edge_vertices"], np.int32)
        self.edge_faces: I4 = _frozen(mesh["edge_faces"], np.int32)
        planes = face_planes(self.positions, self.faces)
        self._farthest_plane = planes.farthest
        anchors = np.concatenate([tree["front_anchor"], tree["back_anchor"]]).astype(np.float64)
        self._farthest_anchor = max(1.0, float(np.sqrt((anchors**2).sum(axis=1)).max(initial=0.0)))
        self._packed = _pack(tree, self.edge_vertices, self.edge_faces, (planes.x, planes.y, planes.z, planes.d))
        self._scratch = _Scratch(len(self._packed.next_block), len(self._packed.lane_vertices))

    def extract(self, eye: F8) -> Extraction:
        """Silhouette for a homogeneous eye (4,) f8 in the normalised frame (`schemas.conventions`).

        Raises ValueError when the eye is not finite or its last coordinate is neither 1 nor 0.
        """
        eye = np.ascontiguousarray(eye, np.float64)
        if eye.shape != (4,):
            raise ValueError("an eye is four numbers")
        x, y, z, w = eye.tolist()
        length = math.hypot(x, y, z)
        if not math.isfinite(x + y + z + w) or w not in (0.0, 1.0):
            raise ValueError("an eye is four finite numbers, the last one 1 or 0")
        if not length < _FARTHEST_EYE or (w == 0.0 and length < _SHORTEST_DIRECTION):
            edges = silhouette_scalar(self.positions, self.faces, self.edge_vertices, self.edge_faces, eye)
            return Extraction(edges, len(self.edge_vertices), 0)
        if w == 0.0:
            return self._walk(eye, x / length, y / length, z / length, 1.0)
        return self._walk(eye, x, y, z, length)

    def _walk(self, eye: F8, x: float, y: float, z: float, length: float) -> Extraction:
        """(x, y, z): the eye, or its unit direction; length: the length of that."""
        w = float(eye[3])
        margin = tree_walk.CONE_ERROR * (length + w * self._farthest_anchor)
        bound = PLANE_ERROR * (_SQRT_3 * length + w * self._farthest_plane) + 1e-30
        w_back = w or _AT_INFINITY
        found = _WALK(*self._packed, *self._scratch.queues, self.positions, self.faces, eye, x, y, z, w_back, margin, bound)
        return Extraction(*found)


def _check(mesh: Mapping[str, Array], tree: Mapping[str, Array]) -> None:
    """Refuse what the kernels could not index safely."""
    start, skip = _ints(tree["edge_start"]), _ints(tree["skip"])
    edges, faces, vertices = len(mesh["edge_vertices"]), len(mesh["faces"]), len(mesh["positions"])
    sound = (
        edges > 0
        and all(_within(mesh[name], limit) for name, limit in (("faces", vertices), ("edge_vertices", vertices), ("edge_faces", faces)))
        and len(mesh["edge_faces"]) == edges
        and len(start) == len(skip) + 1
        and start[0] == 0
        and start[-1] == edges
        and bool(np.all(np.diff(start) >= 0))
        and bool(np.all((skip > np.arange(len(skip))) & (skip <= len(skip))))
        and bool(tree_walk_coarsen.is_nested(skip))
        and np.array_equal(np.sort(_ints(tree["edge_index"])), np.arange(edges))
        and all(np.all(np.isfinite(tree[name])) for name in _CONES)
    )
    if not sound:
        raise CorruptArtifactError("the search tree does not belong to this mesh")


def _ints(values: Array) -> I4:
    return np.array(values, np.int32)


def _floats(values: Array) -> F4:
    return np.array(values, np.float32)


def _within(values: Array, limit: int) -> bool:
    return bool(_ints(values).min(initial=0) >= 0 and _ints(values).max(initial=0) < limit)


def _frozen(values: Array, kind: type[T]) -> npt.NDArray[T]:
    """Contiguous and read-only, as a mapped artifact is: one array type for the compiler wherever the mesh comes from."""
    view = np.ascontiguousarray(values, kind).view()
    view.flags.writeable = False
    return view


def _pack(tree: Mapping[str, Array], edge_vertices: I4, edge_faces: I4, planes: tuple[F4, F4, F4, F4]) -> tree_walk.Packed:
    skip, start, index = (_ints(tree[name]) for name in ("skip", "edge_start", "edge_index"))
    scaled, front, back, separation = (_floats(tree[name]) for name in _CONES)
    parent = tree_walk_coarsen.parents_of(skip)
    keep = tree_walk_coarsen.worth_their_test(skip, start, scaled, parent)
    kept, skip, start, index = tree_walk_coarsen.without(skip, start, index, parent, keep)
    scaled, front, back, separation = scaled[kept], front[kept], back[kept], separation[kept]

    item, below = np.empty((len(kept) + 1, LANES), np.int32), np.empty((len(kept) + 1, LANES), np.int32)
    next_block = np.empty(len(kept) + 1, np.int32)
    blocks = tree_walk_pack.group(skip, start, scaled, item, below, next_block)
    item, below = item[:blocks].copy(), below[:blocks].copy()
    nodes = np.empty((blocks, NODE_ROWS, LANES), np.float32)
    tree_walk_pack.pack_nodes(item, scaled, front, back, separation, nodes)

    first_leaf, record, leaves, lane_face, lane_vertices = _pack_leaves(item, start, index, edge_vertices, edge_faces, planes)
    return tree_walk.Packed(
        nodes=nodes.ravel(),
        below=below.ravel(),
        parents=np.packbits(below >= 0, axis=1, bitorder="little").ravel(),
        guards=np.packbits(first_leaf >= 0, axis=1, bitorder="little").ravel(),
        next_block=next_block[:blocks].copy(),
        used=(item >= 0).sum(axis=1).astype(np.int32),
        first_leaf=first_leaf.ravel(),
        leaves=leaves,
        record=record,
        lane_face=lane_face,
        lane_vertices=lane_vertices,
    )


def _pack_leaves(
    item: I4, start: I4, index: I4, edge_vertices: I4, edge_faces: I4, planes: tuple[F4, F4, F4, F4]
) -> tuple[I4, I4, F4, I4, I4]:
    faces, edges = len(planes[0]), len(edge_vertices)
    first_leaf = np.empty_like(item)
    leaf_start, more = np.empty(edges + 1, np.int32), np.empty(edges, np.int32)
    mark = np.full(faces, -1, np.int32)
    count, order = tree_walk_pack.split_leaves(item, start, index, edge_faces, mark, first_leaf, leaf_start, more)
    record = np.zeros((count, tree_walk.LEAF_COLUMNS), np.int32)
    mark[:] = -1
    floats, face_lanes, edge_lanes = tree_walk_pack.measure_leaves(leaf_start, more, order, edge_faces, mark, record)
    leaves, lane_face = np.empty(floats, np.float32), np.empty(face_lanes, np.int32)
    lane_vertices = np.empty((edge_lanes, 2), np.int32)
    tree_walk_pack.pack_leaves(record, leaf_start, order, edge_vertices, edge_faces, *planes, mark, leaves, lane_face, lane_vertices)
    return first_leaf, record, leaves, lane_face, lane_vertices
