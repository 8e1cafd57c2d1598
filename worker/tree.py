"""The silhouette search tree of a closed mesh.

Based on: Silhouette Clipping, section 5. Departures are listed where they happen: `worker.kernels.cones` (verified cones),
`worker.kernels.forest` (summaries, lazy predictions, limited height), `worker.kernels.tree_links` (links at vertices of many
edges). The footnoted second kind of link, between edges of similar faces that share no vertex, is left out.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
import numpy.typing as npt

from schemas.conventions import F4, F8, I4, Array
from worker.kernels import cones, forest, tree_layout, tree_links

T = TypeVar("T", bound=np.generic)
_LINKS_A_CHUNK = 50_000  # some 0.1 s each: progress is also where a cancelled build stops
_ROUNDS_A_CHUNK = 50_000
_NODES_A_CHUNK = 2_000


@dataclass(frozen=True)
class Tree:
    """A silhouette forest in preorder; the tensors of `schemas.artifacts.TREE`. n nodes, e edges.

    scaled_normal: (n, 3) f4, the axis over the cosine of the opening; zero where a node has no cones. front_anchor,
    back_anchor: (n, 3) f4, normalised frame. separation: (n,) f4, (front_anchor - back_anchor) . scaled_normal rounded up;
    3e38 where there is no back cone. skip: (n,) i4, first node after the subtree. edge_start: (n + 1,) i4 into edge_index
    (e,) i4, rows of the mesh's edge table.
    """

    scaled_normal: F4
    front_anchor: F4
    back_anchor: F4
    separation: F4
    skip: I4
    edge_start: I4
    edge_index: I4

    def __post_init__(self) -> None:
        nodes, edges = len(self.skip), len(self.edge_index)
        if len(self.edge_start) != nodes + 1 or self.edge_start[0] != 0 or self.edge_start[-1] != edges:
            raise ValueError("the nodes of a tree must share out its edges")
        if np.any(self.skip <= np.arange(nodes)) or np.any(self.skip > nodes):
            raise ValueError("a node must skip forward")

    def tensors(self) -> dict[str, Array]:
        """Name -> array, as stored."""
        return {name: getattr(self, name) for name in self.__dataclass_fields__}


@dataclass(frozen=True)
class _Surface:
    positions: F4
    faces: I4
    edge_vertices: I4
    edge_faces: I4
    normals: F8
    offsets: F8
    kinds: Array


def build_tree(positions: F4, faces: I4, edge_vertices: I4, edge_faces: I4, progress: Callable[[float], None]) -> Tree:
    """Silhouette tree of a closed oriented 2-manifold.

    positions (v, 3) f4 in the normalised frame, faces (f, 3) i4, edge_vertices and edge_faces (e, 2) i4 as in
    `geometry.topology.EdgeTable`. `progress` gets values from 0 to 1 several times a second; what it raises ends the build.
    Raises ValueError when positions are not finite, or so far from the unit sphere that the cones' margins would not hold.
    """
    if not np.all(np.abs(positions) <= cones.FARTHEST_ANCHOR):
        raise ValueError("a tree needs finite positions in the normalised frame")
    positions, faces = _frozen(positions, np.float32), _frozen(faces, np.int32)
    edge_vertices, edge_faces = _frozen(edge_vertices, np.int32), _frozen(edge_faces, np.int32)
    normals, offsets = np.empty((len(faces), 3)), np.empty(len(faces))
    kinds = np.empty(len(faces), np.uint8)
    cones.face_constraints(positions, faces, normals, offsets, kinds)
    surface = _Surface(positions, faces, edge_vertices, edge_faces, normals, offsets, kinds)
    progress(0.0)
    state = _empty_forest(surface, _candidate_links(surface))
    _grow(state, surface, progress)
    return _finish(state, surface, progress)


def _frozen(values: Array, kind: type[T]) -> npt.NDArray[T]:
    """Contiguous and read-only, as a mapped artifact is: one array type for the compiler wherever the mesh comes from."""
    view = np.ascontiguousarray(values, kind).view()
    view.flags.writeable = False
    return view


def _candidate_links(surface: _Surface) -> I4:
    ends = surface.edge_vertices.ravel()
    order = np.argsort(ends, kind="stable")
    incident = (order // 2).astype(np.int32)
    starts = np.concatenate([[0], np.cumsum(np.bincount(ends, minlength=len(surface.positions)))]).astype(np.int32)
    face_edges = tree_links.edges_of_faces(surface.edge_faces, len(surface.faces))
    none = np.empty((0, 2), np.int32)
    around = tree_links.vertex_links(surface.edge_vertices, starts, incident, none)
    beside = tree_links.face_links(face_edges, surface.edge_vertices, starts, none)
    links = np.empty((around + beside, 2), np.int32)
    if around:
        tree_links.vertex_links(surface.edge_vertices, starts, incident, links[:around])
    if beside:
        tree_links.face_links(face_edges, surface.edge_vertices, starts, links[around:])
    return links


def _empty_forest(surface: _Surface, links: I4) -> forest.Forest:
    e, n = len(surface.edge_vertices), 2 * len(surface.edge_vertices)
    seen = 1 << max(10, int(4 * e).bit_length())

    def numbers(count: int) -> I4:
        return np.full(count, -1, np.int32)

    return forest.Forest(
        normals=surface.normals,
        offsets=surface.offsets,
        owner=numbers(e),
        uid=numbers(e),
        summary=np.full((e, forest.SUMMARY), -1, np.int32),
        summary_size=numbers(e),
        flags=np.zeros(e, np.uint8),
        box=np.empty((e, 6), np.float32),
        miss=np.ones(e, np.float32),
        weight=np.ones(e, np.float32),
        height=numbers(e),
        node=numbers(e),
        first_edge=numbers(n),
        last_edge=numbers(n),
        next_edge=numbers(e),
        first_child=numbers(n),
        last_child=numbers(n),
        next_sibling=numbers(n),
        links=links,
        link_uid=np.empty((len(links), 2), np.int32),
        key=np.empty(len(links), np.float32),
        heap=numbers(len(links)),
        seen=np.zeros(seen, np.int64),
        counters=np.zeros(4, np.int64),
    )


def _grow(state: forest.Forest, surface: _Surface, progress: Callable[[float], None]) -> None:
    """Predict all candidate joins (to 0.3 of the progress), then join until nothing is gained (to 0.85)."""
    forest.start(state, surface.edge_faces, surface.kinds, surface.positions, surface.faces)
    count = len(state.links)
    for begin in range(0, count, _LINKS_A_CHUNK):
        forest.predict_links(state, begin, min(begin + _LINKS_A_CHUNK, count))
        progress(0.3 * begin / count)
    forest.order_heap(state)
    most = left = int(state.counters[forest.HEAP_SIZE])
    while left:
        left = forest.grow(state, _ROUNDS_A_CHUNK)
        progress(0.3 + 0.55 * (1.0 - left / most))


def _finish(state: forest.Forest, surface: _Surface, progress: Callable[[float], None]) -> Tree:
    """Flatten, make the cones from all faces, drop nodes not worth their test."""
    e = len(surface.edge_vertices)
    roots = state.node[state.owner == np.arange(e)]
    skip, edge_start = np.empty(2 * e, np.int32), np.empty(2 * e + 1, np.int32)
    edge_index = np.empty(e, np.int32)
    n = tree_layout.flatten(roots, state.first_edge, state.next_edge, state.first_child, state.next_sibling, skip, edge_start, edge_index)
    tree = _cones(skip[:n].copy(), edge_start[: n + 1].copy(), edge_index, surface, progress)
    progress(1.0)
    return tree


def _cones(skip: I4, edge_start: I4, edge_index: I4, surface: _Surface, progress: Callable[[float], None]) -> Tree:
    n, f = len(skip), len(surface.faces)
    scaled, front, back = (np.empty((n, 3), np.float32) for _ in range(3))
    separation, miss = np.empty(n, np.float32), np.empty(n)
    mark, index = np.full(f, -1, np.int32), np.empty(f, np.int32)
    for begin in range(0, n, _NODES_A_CHUNK):
        tree_layout.cone_nodes(
            begin, min(begin + _NODES_A_CHUNK, n), skip, edge_start, edge_index, surface.edge_faces, surface.positions,
            surface.faces, surface.normals, surface.offsets, surface.kinds, mark, index, scaled, front, back, separation, miss,
        )  # fmt: skip
        progress(0.86 + 0.14 * begin / n)
    return Tree(scaled, front, back, separation, skip, edge_start, edge_index)
