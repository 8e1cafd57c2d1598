"""The point of a surface that is closest to another, by its box hierarchy (`geometry.boxes`)."""

from __future__ import annotations

import numpy as np
from numba import njit

from geometry.borrowing import borrowing
from geometry.boxes import LEAF, STACK

DOUBT = 1e-13
"""What rounding can take from the squared distance of a triangle whose coordinates are below 4: 2 x 4 x 20 x 4 x 2^-53."""


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
