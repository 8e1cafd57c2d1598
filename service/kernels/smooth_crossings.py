"""Where the contour of a surface with interpolated normals runs over a mesh: across faces and along creases.

The facing of a corner is its normal times the way to the eye; along an edge it is taken as linear. What is front-facing is then a
region of the surface, and the contours are its boundary, kept on the left: segments across the faces whose corners
differ, and parts of creases whose two sides differ. Signs decide everything, so the boundary is closed whatever rounding does.

Its nodes have numbers: vertex i is i; the place on edge e where the facing changes sign is v + 2 e + s, s being 0, but 1 on the
right-hand side of a crease.
"""

from __future__ import annotations

import numpy as np
from numba import njit


@njit(cache=True, nogil=True)
def facings(positions, normals, vertices, eye):
    """(n,) f8: facing of normals (n, 3) at positions[vertices], for a homogeneous eye (4,)."""
    out = np.empty(normals.shape[0])
    for i in range(normals.shape[0]):
        p = positions[vertices[i]]
        total = 0.0
        for k in range(3):
            total += np.float64(normals[i, k]) * (eye[k] - eye[3] * np.float64(p[k]))
        out[i] = total
    return out


@njit(cache=True, nogil=True)
def mixed_edges(facing, rows):
    """Numbers (k,) i4 of the edges whose four ends, rows (e, 2, 2) i4 by side and end, do not all face the same way."""
    out = np.empty(rows.shape[0], np.int32)
    count = 0
    for e in range(rows.shape[0]):
        front = facing[rows[e, 0, 0]] >= 0.0
        same = front == (facing[rows[e, 0, 1]] >= 0.0)
        same &= front == (facing[rows[e, 1, 0]] >= 0.0)
        same &= front == (facing[rows[e, 1, 1]] >= 0.0)
        out[count] = e
        count += not same
    return out[:count].copy()


@njit(cache=True, nogil=True)
def crossing_of(a, b):
    """Where between 0 and 1 a linear function goes through zero that is a at 0 and b at 1, of different signs."""
    return a / (a - b) if a != b else 0.5


@njit(cache=True, nogil=True)
def boundary(chosen, facing, rows, edge_vertices, edge_faces, vertex_count):
    """The boundary on and beside the chosen edges.

    ends (k, 3) i8 (face, 0 where a segment begins or 1 where it ends, node) of the segments across faces, and parts (m, 3)
    i8 (first node, last node, edge) of creases.
    """
    ends = np.empty((2 * chosen.shape[0], 3), np.int64)
    parts = np.empty((3 * chosen.shape[0], 3), np.int64)
    n, m = 0, 0
    for e in chosen:
        a, b = edge_vertices[e, 0], edge_vertices[e, 1]
        la, lb = facing[rows[e, 0, 0]], facing[rows[e, 0, 1]]
        ra, rb = facing[rows[e, 1, 0]], facing[rows[e, 1, 1]]
        crease = rows[e, 0, 0] != rows[e, 1, 0] or rows[e, 0, 1] != rows[e, 1, 1]
        left, right = vertex_count + 2 * e, vertex_count + 2 * e + (1 if crease else 0)
        # the left face has the edge from a to b: going along it, a segment begins where the front ends
        left_cut, right_cut = (la >= 0.0) != (lb >= 0.0), (ra >= 0.0) != (rb >= 0.0)
        if left_cut:
            ends[n, 0], ends[n, 1], ends[n, 2] = edge_faces[e, 0], 0 if la >= 0.0 else 1, left
            n += 1
        if right_cut:
            ends[n, 0], ends[n, 1], ends[n, 2] = edge_faces[e, 1], 0 if rb >= 0.0 else 1, right
            n += 1
        if not crease:
            continue
        in_left, in_right = la >= 0.0, ra >= 0.0
        right_first = left_cut and right_cut and crossing_of(ra, rb) < crossing_of(la, lb)
        before = np.int64(a)
        for step in range(3):
            # the cut of one side, the cut of the other, the end of the edge
            of_left = (step == 0) != right_first
            if step < 2 and not (left_cut if of_left else right_cut):
                continue
            here = np.int64(b) if step == 2 else (left if of_left else right)
            if in_left != in_right:
                parts[m, 0], parts[m, 1], parts[m, 2] = before if in_left else here, here if in_left else before, e
                m += 1
            if step < 2:
                if of_left:
                    in_left = not in_left
                else:
                    in_right = not in_right
            before = here
    return ends[:n], parts[:m]
