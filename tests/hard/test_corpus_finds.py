"""What running whole folders of meshes found, each as small as it gets."""

from __future__ import annotations

import numpy as np

from geometry.topology import build_edges
from geometry.union_find import find_root
from worker import tree
from worker.kernels.forest import Forest


def belted_drum(sides: int, thin: float):
    """A closed drum about z with a belt of faces of this height: (positions (v, 3) f4, faces (f, 3) i4)."""
    turn = np.arange(sides) / sides * 2.0 * np.pi
    heights = (-0.5, 0.0, thin, 0.5)
    rings = [np.column_stack([0.6 * np.cos(turn), 0.6 * np.sin(turn), np.full(sides, h)]) for h in heights]
    i, last = np.arange(sides), (len(heights) - 1) * sides
    j, below = (i + 1) % sides, np.full(sides, last + sides)
    faces = [np.column_stack([j, i, below]), np.column_stack([last + i, last + j, below + 1])]
    for start in range(0, last, sides):
        a, b = start + i, start + j
        faces += [np.column_stack([a, b, b + sides]), np.column_stack([a, b + sides, a + sides])]
    return np.concatenate([*rings, [[0.0, 0.0, -0.8], [0.0, 0.0, 0.8]]]).astype(np.float32), np.concatenate(faces).astype(np.int32)


def grown(monkeypatch, positions, faces) -> Forest:
    """The forest of a mesh when all joins are made."""
    kept = []
    monkeypatch.setattr(tree, "_finish", lambda state, *_: kept.append(state))
    edges = build_edges(faces)
    tree.build_tree(positions, faces, edges.vertices, edges.faces, lambda _: None)
    return kept[0]


def test_clusters_of_slivers_are_summarised_by_faces_of_their_own(monkeypatch):
    """Faces thinner than a normal can be told of have no cones: what another cluster's rest on was taken for theirs, or plain memory."""
    positions, faces = belted_drum(6, 1e-10)
    forest = grown(monkeypatch, positions, faces)
    edge_faces = build_edges(faces).faces
    roots = np.array([find_root(forest.owner, edge) for edge in range(len(edge_faces))])
    assert (forest.flags[np.unique(roots)] != 0).any()
    for root in np.unique(roots):
        assert set(forest.summary[root, : forest.summary_size[root]].tolist()) <= set(edge_faces[roots == root].ravel().tolist())
