"""A stored silhouette tree checked, made coarser where that is faster, and packed as `service.kernels.tree_walk` reads it."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from schemas.conventions import F4, I4, Array
from schemas.errors import CorruptArtifactError
from service.kernels import tree_walk, tree_walk_coarsen, tree_walk_pack, tree_walk_pack_leaves
from service.kernels.tree_walk_lanes import LANES

_SPARE_LINES = 16
"""Behind the last leaf: tests read on to the end of their lanes."""
_CONES = ("scaled_normal", "front_anchor", "back_anchor", "separation")


def check_tree(mesh: Mapping[str, Array], tree: Mapping[str, Array]) -> None:
    """Raise CorruptArtifactError for what the kernels could not index safely, and for an edge that is not in one node."""
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


def pack_tree(positions: F4, faces: I4, edge_vertices: I4, edge_faces: I4, tree: Mapping[str, Array]) -> tuple[I4, int]:
    """(arena, length of a queue): tensors of `schemas.artifacts.TREE`, checked, as the walk reads them.

    The arena is words of 32 bits on the boundary of a cache line: node blocks, leaves, and the corners of every leaf's faces.
    """
    skip, start, index = (_ints(tree[name]) for name in ("skip", "edge_start", "edge_index"))
    cones = [np.array(tree[name], np.float32) for name in _CONES]
    parent = tree_walk_coarsen.parents_of(skip)
    miss = tree_walk_coarsen.miss_probability(cones[0], cones[3])
    keep = tree_walk_coarsen.worth_their_test(start, miss, parent)
    kept, skip, start, index = tree_walk_coarsen.without(skip, start, index, parent, keep)

    item, below, next_block = _blocks(skip, start, cones[0][kept])
    first_leaf, order = np.empty_like(item), np.empty_like(index)
    record = np.empty((len(index), tree_walk_pack_leaves.COLUMNS), np.int32)
    face_mark, vertex_mark = np.full(len(faces), -1, np.int32), np.full(len(positions), -1, np.int32)
    planes = tree_walk_pack_leaves.unit_planes(positions, faces)
    leaves, lines, listed = tree_walk_pack_leaves.split_leaves(
        item, start, index, edge_faces, edge_vertices, planes, face_mark, vertex_mark, first_leaf, order, record
    )
    record = record[:leaves].copy()
    first_line = len(item) * tree_walk.BLOCK_WORDS // tree_walk.LINE
    arena = _lines(first_line + lines + -(-(3 * listed + tree_walk.PLANE_WORDS * leaves) // tree_walk.LINE))
    at = np.where(first_leaf >= 0, first_line + record[first_leaf, tree_walk_pack_leaves.AT], -1).astype(np.int32)
    scaled, front, back, separation = (cone[kept] for cone in cones)
    tree_walk_pack.pack_nodes(item, below, next_block, at, scaled, front, back, separation, arena)
    reach = float(np.sqrt((positions.astype(np.float64) ** 2).sum(axis=1)).max())
    first_word, lane = first_line * tree_walk.LINE, (first_line + lines) * tree_walk.LINE
    tree_walk_pack_leaves.pack_leaves(
        record, first_word, order, edge_vertices, edge_faces, faces, planes, reach, face_mark, vertex_mark, arena, lane
    )
    return arena, max((len(item) + 1) * LANES, leaves + 1)


def _blocks(skip: I4, start: I4, scaled_normal: F4) -> tuple[I4, I4, I4]:
    """Items, blocks below (b, LANES) i4 and next blocks (b,) i4."""
    most = len(skip) + 1
    item, below, next_block = np.empty((most, LANES), np.int32), np.empty((most, LANES), np.int32), np.empty(most, np.int32)
    blocks = tree_walk_pack.group(skip, start, scaled_normal, item, below, next_block)
    return item[:blocks].copy(), below[:blocks].copy(), next_block[:blocks].copy()


def _lines(count: int) -> I4:
    """Zeros of `count` cache lines and some to read over the end, from a boundary on."""
    words = np.zeros((count + _SPARE_LINES + 1) * tree_walk.LINE, np.int32)
    skip = -(words.ctypes.data // words.itemsize) % tree_walk.LINE
    return words[skip : skip + (count + _SPARE_LINES) * tree_walk.LINE]


def _ints(values: Array) -> I4:
    return np.array(values, np.int32)


def _within(values: Array, limit: int) -> bool:
    return bool(_ints(values).min(initial=0) >= 0 and _ints(values).max(initial=0) < limit)
