"""The stored sequence of a progressive hull, and cutting a hull of any size from it.

A step changes the mesh that the steps before it made: a *collapse* (a, b) moves vertex a to the step's position and merges b
into it; a *move* (a, -1) moves vertex a; a *flip* (~f, ~g), both negative, turns the edge that faces f and g share. Vertices and
faces are numbered as in the original. Every prefix of the sequence is a hull.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from geometry.union_find import find_root

MOVE = -1
"""Second number of a step that moves a vertex and merges nothing."""


def cut_hull(
    positions: np.ndarray, faces: np.ndarray, step_vertices: np.ndarray, step_positions: np.ndarray, max_faces: int
) -> tuple[np.ndarray, np.ndarray]:
    """The hull of at most max_faces faces, shrunk as far as the sequence shrinks it at that size; at worst its last mesh.

    positions (v, 3) f4 and faces (f, 3) i4: the original. step_vertices (s, 2) i4 and step_positions (s, 3) f4: see above.
    Returns (positions (hv, 3) f4, faces (hf, 3) i4) without unused vertices; vertices and faces keep the original's order.
    """
    return replay_steps(positions, faces, step_vertices, step_positions, steps_to(step_vertices, len(faces), max_faces))


def steps_to(step_vertices: np.ndarray, face_count: int, max_faces: int) -> int:
    """Length of the prefix after which at most max_faces of face_count faces are left, with the moves and flips that follow."""
    collapses = np.flatnonzero(np.all(np.asarray(step_vertices) >= 0, axis=1))
    needed = max(0, (face_count - max_faces + 1) // 2)
    return int(collapses[needed]) if needed < len(collapses) else len(step_vertices)


def replay_steps(
    positions: np.ndarray, faces: np.ndarray, step_vertices: np.ndarray, step_positions: np.ndarray, steps: int
) -> tuple[np.ndarray, np.ndarray]:
    """The hull after the first `steps` steps; arrays as in `cut_hull`."""
    moved, corners = np.array(positions, np.float32), np.array(faces, np.int32)
    taken = np.array(step_vertices[:steps], np.int32), np.array(step_positions[:steps], np.float32)
    _replay(moved, corners, *taken)
    kept = corners[(corners[:, 0] != corners[:, 1]) & (corners[:, 1] != corners[:, 2]) & (corners[:, 2] != corners[:, 0])]
    used = np.zeros(len(moved), np.bool_)
    used[kept] = True
    number = np.cumsum(used, dtype=np.int32) - 1
    return moved[used], np.ascontiguousarray(number[kept], np.int32)


@njit(cache=True, nogil=True)
def _replay(positions, faces, step_vertices, step_positions):
    """Make all steps: positions (v, 3) f4 and faces (f, 3) i4 change in place; what has vanished repeats a vertex."""
    merged = np.arange(positions.shape[0])
    for k in range(step_vertices.shape[0]):
        a, b = step_vertices[k, 0], step_vertices[k, 1]
        if a < 0:
            _flip(faces, merged, ~a, ~b)
            continue
        if b >= 0:
            merged[b] = a
        for axis in range(3):
            positions[a, axis] = step_positions[k, axis]
    for f in range(faces.shape[0]):
        for i in range(3):
            faces[f, i] = find_root(merged, faces[f, i])


@njit(cache=True, nogil=True)
def _flip(faces, merged, f, g):
    """Turn the edge of faces f and g: in f its larger vertex gives way to the apex of g, in g its smaller to that of f."""
    for i in range(3):
        faces[f, i], faces[g, i] = find_root(merged, faces[f, i]), find_root(merged, faces[g, i])
    for i in range(3):
        p, q = faces[f, i], faces[f, (i + 1) % 3]
        for j in range(3):
            if faces[g, j] == q and faces[g, (j + 1) % 3] == p:
                apex_f, apex_g = faces[f, (i + 2) % 3], faces[g, (j + 2) % 3]
                faces[f, (i + 1) % 3 if q > p else i] = apex_g
                faces[g, (j + 1) % 3 if q > p else j] = apex_f
                return
