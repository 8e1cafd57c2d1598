"""A box hierarchy over triangles: the closest point, and the ground for the exact enclosure tests.

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
DOUBT = 1e-13
"""What rounding can take from the squared distance of a triangle whose coordinates are below 4: 2 x 4 x 20 x 4 x 2^-53."""
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
def _box_distance2(box, x, y, z):
    dx = max(box[0] - x, 0.0, x - box[3])
    dy = max(box[1] - y, 0.0, y - box[4])
    dz = max(box[2] - z, 0.0, z - box[5])
    return dx * dx + dy * dy + dz * dz


@borrowing
def _segment_parameter(px, py, pz, ux, uy, uz):
    """Parameter in [0, 1] of the point of the segment from 0 to u that is closest to p."""
    uu = ux * ux + uy * uy + uz * uz
    if uu == 0.0:
        return 0.0
    return min(1.0, max(0.0, (px * ux + py * uy + pz * uz) / uu))


@borrowing
def closest_on_triangle(a, b, c, x, y, z):
    """(squared distance, s, t): the closest point of the triangle to (x, y, z) is a + s (b - a) + t (c - a)."""
    ax, ay, az = np.float64(a[0]), np.float64(a[1]), np.float64(a[2])
    ux, uy, uz = b[0] - ax, b[1] - ay, b[2] - az
    vx, vy, vz = c[0] - ax, c[1] - ay, c[2] - az
    px, py, pz = x - ax, y - ay, z - az
    uu, uv, vv = ux * ux + uy * uy + uz * uz, ux * vx + uy * vy + uz * vz, vx * vx + vy * vy + vz * vz
    pu, pv = px * ux + py * uy + pz * uz, px * vx + py * vy + pz * vz
    det = uu * vv - uv * uv
    best_s, best_t, best = 0.0, 0.0, np.inf
    if det > 0.0:
        s, t = (vv * pu - uv * pv) / det, (uu * pv - uv * pu) / det
        if s >= 0.0 and t >= 0.0 and s + t <= 1.0:
            dx, dy, dz = px - s * ux - t * vx, py - s * uy - t * vy, pz - s * uz - t * vz
            best_s, best_t, best = s, t, dx * dx + dy * dy + dz * dz
    # the three sides as well, always: for a needle the interior solution above is not to be trusted
    for side in range(3):
        if side == 0:
            s, t = _segment_parameter(px, py, pz, ux, uy, uz), 0.0
        elif side == 1:
            s, t = 0.0, _segment_parameter(px, py, pz, vx, vy, vz)
        else:
            t = _segment_parameter(px - ux, py - uy, pz - uz, vx - ux, vy - uy, vz - uz)
            s = 1.0 - t
        dx, dy, dz = px - s * ux - t * vx, py - s * uy - t * vy, pz - s * uz - t * vz
        distance2 = dx * dx + dy * dy + dz * dz
        if distance2 < best:
            best_s, best_t, best = s, t, distance2
    return best, best_s, best_t


@borrowing
def _beyond(a, b, c, x, y, z, best):
    """Whether the box about a triangle is further from (x, y, z) than the square root of best, by more than rounding."""
    far = best + DOUBT
    dx = max(min(a[0], b[0], c[0]) - x, 0.0, x - max(a[0], b[0], c[0]))
    square = dx * dx
    if square > far:
        return True
    dy = max(min(a[1], b[1], c[1]) - y, 0.0, y - max(a[1], b[1], c[1]))
    square += dy * dy
    if square > far:
        return True
    dz = max(min(a[2], b[2], c[2]) - z, 0.0, z - max(a[2], b[2], c[2]))
    return square + dz * dz > far


@borrowing
def closest_face(positions, faces, order, boxes, x, y, z, known, stack, near):
    """(squared distance, face, s, t) of the triangle closest to (x, y, z), as `closest_on_triangle`, and how many nodes were looked into.

    known: a face that may be close, -1 for none. stack i8, near f8 (STACK,): scratch.
    """
    leaves = boxes.shape[0] // 2
    best, face, best_s, best_t = np.inf, np.int64(known), 0.0, 0.0
    if known >= 0:
        a, b, c = positions[faces[known, 0]], positions[faces[known, 1]], positions[faces[known, 2]]
        best, best_s, best_t = closest_on_triangle(a, b, c, x, y, z)
    stack[0], near[0], top, visits = 1, 0.0, 1, 0
    while top > 0:
        top -= 1
        node = stack[top]
        if near[top] >= best:
            continue
        visits += 1
        if node >= leaves:
            start = (node - leaves) * LEAF
            for i in range(start, min(start + LEAF, faces.shape[0])):
                f = order[i]
                a, b, c = positions[faces[f, 0]], positions[faces[f, 1]], positions[faces[f, 2]]
                if _beyond(a, b, c, x, y, z, best):
                    continue
                d, s, t = closest_on_triangle(a, b, c, x, y, z)
                if d < best:
                    best, face, best_s, best_t = d, f, s, t
            continue
        first, second = 2 * node, 2 * node + 1
        d1, d2 = _box_distance2(boxes[first], x, y, z), _box_distance2(boxes[second], x, y, z)
        if d1 < d2:
            first, second, d1, d2 = second, first, d2, d1
        if d1 < best:
            stack[top], near[top] = first, d1
            top += 1
        if d2 < best:
            stack[top], near[top] = second, d2
            top += 1
    return best, face, best_s, best_t, visits


@njit(cache=True, nogil=True)
def closest_points(positions, faces, order, boxes, points):
    """(face (n,) i4, weights (n, 3) f8, squared distance (n,) f8) of the triangle point closest to each of points (n, 3) f8."""
    count = points.shape[0]
    face, weights, found = np.empty(count, np.int32), np.empty((count, 3)), np.empty(count)
    stack, near = np.empty(STACK, np.int64), np.empty(STACK)
    for n in range(count):
        x, y, z = points[n, 0], points[n, 1], points[n, 2]
        found[n], face[n], s, t, _ = closest_face(positions, faces, order, boxes, x, y, z, -1, stack, near)
        weights[n, 0], weights[n, 1], weights[n, 2] = 1.0 - s - t, s, t
    return face, weights, found
