"""Closed meshes from scalar fields by marching tetrahedra (Doi and Koide 1991): manifold by construction, whatever the field.

Cells are cut into six tetrahedra about their diagonal, which fit together from cell to cell (Kuhn 1960). A mesh's corners lie on edges
of tetrahedra, never at their ends, so no two of them coincide and no face is without area. Cut at parts of edges that are powers of two,
their coordinates are exact: many corners lie in one plane, many edges in one line, many eyes of `tests.eye_cases` in both.
"""

from __future__ import annotations

from itertools import permutations

import numpy as np

CELLS = 8
"""Along each side of the cube [-1/2, 1/2]^3."""


def marched(values, parts=None):
    """(positions (v, 3) f4, faces (f, 3) i4) of the surface about values < 0 at the nodes (n, n, n) of the cube; no faces for none.

    The outermost nodes count as outside. parts: edges are cut at multiples of 1 / parts of their length; None: where the field is 0.
    """
    field = np.maximum(np.asarray(values, np.float64), 1e-3 * _border(len(values)))
    tets = _tetrahedra(len(values))
    inside = field.ravel()[tets] < 0.0
    masks = (inside * [1, 2, 4, 8]).sum(axis=1)
    edges = [_cut_edges(tets[masks == mask], triangles) for mask, triangles in enumerate(TRIANGLES) if triangles]
    ends = np.concatenate([np.empty((0, 3, 2), np.int64), *edges])
    cut, corner = np.unique(np.sort(ends.reshape(-1, 2), axis=1), axis=0, return_inverse=True)
    a, b = field.ravel()[cut].T
    along = a / (a - b)
    along = np.clip(along if parts is None else np.round(along * parts) / parts, 1.0 / (parts or 64), 1.0 - 1.0 / (parts or 64))
    nodes = np.stack(np.unravel_index(cut, field.shape), axis=-1) / (len(values) - 1) - 0.5
    positions = nodes[:, 0] + along[:, None] * (nodes[:, 1] - nodes[:, 0])
    return positions.astype(np.float32), corner.reshape(-1, 3).astype(np.int32)


def grid(cells=CELLS):
    """(3, n, n, n) f8: the coordinates of the nodes."""
    return np.stack(np.meshgrid(*[np.linspace(-0.5, 0.5, cells + 1)] * 3, indexing="ij"))


def sphere(p, centre, radius):
    return np.sqrt(((p - _column(centre)) ** 2).sum(axis=0)) - radius


def box(p, centre, half):
    return (np.abs(p - _column(centre)) - _column(half)).max(axis=0)


def torus(p, centre, radius, tube, axis):
    q = np.roll(p - _column(centre), axis, axis=0)
    return np.hypot(np.hypot(q[0], q[1]) - radius, q[2]) - tube


def waves(p, rng, level):
    """A smooth random field, high on average by `level`."""
    k, phase = rng.normal(size=(6, 3)) * 6.0, rng.uniform(0.0, 2.0 * np.pi, 6)
    return np.cos(np.tensordot(k, p, 1) + phase[:, None, None, None]).mean(axis=0) + level


def _column(values):
    return np.asarray(values, np.float64).reshape(3, 1, 1, 1)


def _border(n):
    """(n, n, n): 1 at the outermost nodes, elsewhere so low that it does not count."""
    border = np.full((n, n, n), -np.inf)
    for axis in range(3):
        np.moveaxis(border, axis, 0)[[0, -1]] = 1.0
    return border


def _tetrahedra(n):
    """(t, 4) i8 nodes, positively oriented: a step along each axis from corner to corner of a cell, in all six orders."""
    node = np.arange(n**3).reshape(n, n, n)
    stride = np.array([n * n, n, 1])
    first = node[:-1, :-1, :-1].reshape(-1, 1)
    found = []
    for order in permutations(range(3)):
        path = np.concatenate([[0], np.cumsum(stride[list(order)])])
        odd = np.linalg.det(np.eye(3)[list(order)]) < 0.0
        found.append(first + (path[[0, 2, 1, 3]] if odd else path))
    return np.concatenate(found)


def _triangles(mask):
    """Of corners with the bits of `mask` inside: triangles whose corners lie on edges (from, to), counter-clockwise seen from outside.

    With i, j, k, l positively oriented: about a lone corner i the edges to j, k, l; between i, j and k, l the four edges that join them.
    """
    inside = [corner for corner in range(4) if mask >> corner & 1]
    lone = inside if len(inside) == 1 else [corner for corner in range(4) if corner not in inside]
    first = inside if len(inside) == 2 else lone
    if len(inside) in (0, 4):
        return []
    even = (p for p in permutations(range(4)) if np.linalg.det(np.eye(4)[list(p)]) > 0.0)
    i, j, k, l = next(p for p in even if set(p[: len(first)]) == set(first))  # noqa: E741
    if len(inside) == 2:
        return [[(i, k), (i, l), (j, l)], [(i, k), (j, l), (j, k)]]
    about = [(i, j), (i, k), (i, l)]
    return [about if len(inside) == 1 else about[::-1]]


TRIANGLES = [_triangles(mask) for mask in range(16)]


def _cut_edges(tets, triangles):
    """(m, 3, 2) i8: the nodes at the ends of the edges that hold the corners of the triangles."""
    return tets[:, np.array(triangles)].reshape(-1, 3, 2)
