"""An independent reading of a stored silhouette tree: are its cones sound, and what does a walk reach?

Silhouette Clipping, section 5, straight from the definitions and in float64; shares nothing with the code that builds trees
or walks them for a frame.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

NO_BACK_CONE = 1e38  # separations beyond: no eye is in the back cone
NORMAL_DOUBT = 1e-8  # relative error of a face's normal beyond which its cones are not judged
EXACTNESS = 1e-12  # rounding of the judgement itself


@njit(cache=True, nogil=True)
def unsound_node(surface, cones, skip, edge_start, edge_index):
    """First node with a cone that leaves the front (or back) half-space of a face under it; -1 where all are sound.

    surface: positions (v, 3) f4, faces (f, 3) i4, edge_faces (e, 2) i4. cones: scaled normals, front anchors, back anchors
    (n, 3) f4, separations (n,) f4. The cone {x: s . x >= |x|} lies in {x: n . x >= 0} when n . s >= sqrt(|s|^2 - 1).
    """
    positions, faces, edge_faces = surface
    scaled_normal, front_anchor, back_anchor, separation = cones
    normal = np.empty((faces.shape[0], 3))
    for f in range(faces.shape[0]):
        u, v = np.empty(3), np.empty(3)
        for k in range(3):
            a = np.float64(positions[faces[f, 0], k])
            u[k], v[k] = positions[faces[f, 1], k] - a, positions[faces[f, 2], k] - a
        normal[f, 0] = u[1] * v[2] - u[2] * v[1]
        normal[f, 1] = u[2] * v[0] - u[0] * v[2]
        normal[f, 2] = u[0] * v[1] - u[1] * v[0]
        length = math.sqrt((normal[f] ** 2).sum())
        doubtful = not length * NORMAL_DOUBT > 1.8e-15 * math.sqrt((u**2).sum() * (v**2).sum())
        normal[f] *= 0.0 if doubtful else 1.0 / length
    for node in range(skip.shape[0]):
        sx, sy, sz = np.float64(scaled_normal[node, 0]), np.float64(scaled_normal[node, 1]), np.float64(scaled_normal[node, 2])
        square = sx * sx + sy * sy + sz * sz
        if square == 0.0:
            continue
        least = math.sqrt(max(0.0, square - 1.0)) * (1.0 - EXACTNESS)
        back = separation[node] < NO_BACK_CONE
        for i in range(edge_start[node], edge_start[skip[node]]):
            for side in range(2):
                f = edge_faces[edge_index[i], side]
                n = normal[f]
                if n[0] == 0.0 and n[1] == 0.0 and n[2] == 0.0:
                    continue
                if n[0] * sx + n[1] * sy + n[2] * sz < least:
                    return node
                front_height = back_height = 0.0
                for k in range(3):
                    a = np.float64(positions[faces[f, 0], k])
                    front_height += n[k] * (front_anchor[node, k] - a)
                    back_height += n[k] * (back_anchor[node, k] - a)
                if front_height < -EXACTNESS or (back and back_height > EXACTNESS):
                    return node
        if back:
            d = 0.0
            for k in range(3):
                d += (np.float64(front_anchor[node, k]) - back_anchor[node, k]) * scaled_normal[node, k]
            if separation[node] < d - 1e-7 * (1.0 + abs(d)):
                return node
    return -1


@njit(cache=True, nogil=True)
def reached_edges(cones, skip, edge_start, edge_index, eye, reached):
    """Mark in reached (e,) bool the edges of the nodes that a walk for eye (4,) f8 does not cull; cones as in `unsound_node`."""
    scaled_normal, front_anchor, back_anchor, separation = cones
    node = 0
    while node < skip.shape[0]:
        along_front = along_back = far_front = far_back = 0.0
        for k in range(3):
            s = np.float64(scaled_normal[node, k])
            x, y = eye[k] - eye[3] * front_anchor[node, k], eye[k] - eye[3] * back_anchor[node, k]
            along_front += s * x
            along_back += s * y
            far_front += x * x
            far_back += y * y
        in_front = along_front > 0.0 and along_front * along_front >= far_front
        in_back = separation[node] < NO_BACK_CONE and along_back < 0.0 and along_back * along_back >= far_back
        if in_front or in_back:
            node = skip[node]
            continue
        for i in range(edge_start[node], edge_start[node + 1]):
            reached[edge_index[i]] = True
        node += 1


@njit(cache=True, nogil=True)
def unnested_node(skip):
    """First node of a preorder whose subtree is empty, ends behind the last node, or runs over its parent's end; -1: none."""
    ends = np.empty(skip.shape[0] + 1, np.int64)
    ends[0], depth = skip.shape[0], 1
    for node in range(skip.shape[0]):
        while ends[depth - 1] == node:
            depth -= 1
        if skip[node] <= node or skip[node] > ends[depth - 1]:
            return node
        ends[depth] = skip[node]
        depth += 1
    return -1
