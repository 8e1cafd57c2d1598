"""A box hierarchy over triangles.

The triangles are halved by their centroids, across where these reach furthest, down to leaves of LEAF. The nodes are a complete
binary tree in heap order (children of i are 2 i and 2 i + 1, leaf k is node P + k with P a power of two). Along a Morton curve,
which is quicker to build, boxes overlap so much that a search looks into five times as many. Boxes of float32
corners are exact. Empty leaves have an inverted box, which nothing meets.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from geometry.borrowing import borrowing

LEAF = 4
STACK = 64  # a heap of 2^30 leaves is 31 deep


@njit(cache=True, nogil=True)
def _centres(positions, faces):
    """(3, f) f8: three times the centroid of each triangle, by axis."""
    centres = np.zeros((3, faces.shape[0]))
    for f in range(faces.shape[0]):
        for k in range(3):
            for i in range(3):
                centres[k, f] += positions[faces[f, i], k]
    return centres


@njit(cache=True, nogil=True)
def _part(row, start, middle, end, right, kept):
    """Bring those of row[start:end] that are on the left before the others, in their order. kept: scratch, as long as row."""
    left, rest = start, 0
    for i in range(start, end):
        f = row[i]
        if right[f]:
            kept[rest] = f
            rest += 1
        else:
            row[left] = f
            left += 1
    for i in range(rest):
        row[middle + i] = kept[i]


@njit(cache=True, nogil=True)
def _halve(centres, rows):
    """Sort rows (3, f) i8, the triangles by each of their centres (3, f) f8, into the order of the leaves, for all axes alike.

    Each node's triangles are halved where they reach furthest, the left half a full subtree; the sorting makes that one pass a level.
    """
    count = rows.shape[1]
    right, kept = np.empty(count, np.bool_), np.empty(count, rows.dtype)
    size = LEAF
    while size < count:
        size *= 2
    while size > LEAF:
        for start in range(0, count, size):
            middle, end = start + size // 2, min(start + size, count)
            if middle >= end:
                continue
            axis, most = 0, -1.0
            for k in range(3):
                extent = centres[k, rows[k, end - 1]] - centres[k, rows[k, start]]
                if extent > most:
                    axis, most = k, extent
            for i in range(start, end):
                right[rows[axis, i]] = i >= middle
            for k in range(3):
                if k != axis:
                    _part(rows[k], start, middle, end, right, kept)
        size //= 2


@njit(cache=True, nogil=True)
def _boxes(positions, faces, order):
    leaves = 1
    while leaves * LEAF < faces.shape[0]:
        leaves *= 2
    boxes = np.empty((2 * leaves, 6), np.float32)
    boxes[:, :3] = np.inf
    boxes[:, 3:] = -np.inf
    for n in range(faces.shape[0]):
        node = leaves + n // LEAF
        for i in range(3):
            for k in range(3):
                x = positions[faces[order[n], i], k]
                boxes[node, k] = min(boxes[node, k], x)
                boxes[node, 3 + k] = max(boxes[node, 3 + k], x)
    for node in range(leaves - 1, 0, -1):
        for k in range(3):
            boxes[node, k] = min(boxes[2 * node, k], boxes[2 * node + 1, k])
            boxes[node, 3 + k] = max(boxes[2 * node, 3 + k], boxes[2 * node + 1, 3 + k])
    return boxes


def build_boxes(positions, faces):
    """(order (f,) i8, boxes (2 P, 6) f4 low and high corners) of triangles. positions (v, 3) f4, faces (f, 3) i4, f > 0."""
    centres = _centres(positions, faces)
    rows = np.argsort(centres, axis=1, kind="stable")
    _halve(centres, rows)
    order = rows[0].copy()
    return order, _boxes(positions, faces, order)


@borrowing
def boxes_meet(one, other):
    """Whether two boxes (6,), low and high corners, have a point in common."""
    apart = one[3] < other[0] or one[0] > other[3] or one[4] < other[1] or one[1] > other[4]
    return not (apart or one[5] < other[2] or one[2] > other[5])


@borrowing
def next_leaf(boxes, reach, stack, top):
    """(leaf, top): the next leaf whose box meets the box reach (6,), of the `top` nodes on the stack (STACK,) i8; -1 when there is none.

    A search begins with the root alone: stack[0], top = 1, 1.
    """
    leaves = boxes.shape[0] // 2
    while top > 0:
        top -= 1
        node = stack[top]
        if not boxes_meet(reach, boxes[node]):
            continue
        if node >= leaves:
            return node - leaves, top
        stack[top], stack[top + 1] = 2 * node, 2 * node + 1
        top += 2
    return -1, 0
