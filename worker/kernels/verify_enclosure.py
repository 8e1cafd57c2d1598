"""Winding numbers and crossings of triangle meshes, decided exactly: what proves that a hull encloses its original.

The winding number of a point counts the faces above it, along +z: plus one for a face that is left upwards there, minus one
for a face that is entered. Which faces lie above is decided in the xy plane by a half-open rule, so that a ray through an
edge or a vertex of the mesh counts each sheet of the surface once, and in height by the exact orientation.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from geometry import expansions as ex
from geometry.predicates import orient_sign
from worker.kernels.bake_boxes import LEAF, STACK

ORIENT2_ERROR = 3.330669073875472e-16  # (3 + 16 u) u, u = 2^-53: Shewchuk's bound for orient2d
UNDERFLOW_GUARD = 1e-280


@njit(cache=True)
def _orient2_sign(ax, ay, bx, by, px, py):
    """Exact sign of det[b - a, p - a]: 1 when p lies left of the line from a to b; all f8."""
    left, right = (bx - ax) * (py - ay), (by - ay) * (px - ax)
    det = left - right
    bound = ORIENT2_ERROR * (abs(left) + abs(right)) + UNDERFLOW_GUARD
    if det > bound:
        return 1
    if det < -bound:
        return -1
    ux, nux = ex.difference(bx, ax)
    uy, nuy = ex.difference(by, ay)
    wx, nwx = ex.difference(px, ax)
    wy, nwy = ex.difference(py, ay)
    total, other = np.empty(16), np.empty(8)
    n = ex.multiply(ux, nux, wy, nwy, total)
    m = ex.multiply(uy, nuy, wx, nwx, other)
    for i in range(m):
        other[i] = -other[i]
    return ex.sign(total, ex.add(total, n, other, m))


@njit(cache=True)
def _covering(a, b, c, x, y):
    """How often the triangle, seen along z, winds about (x, y): 1 counter-clockwise, -1 clockwise, 0 outside."""
    winding = 0
    for k in range(3):
        p, q = (a, b) if k == 0 else ((b, c) if k == 1 else (c, a))
        px, py, qx, qy = np.float64(p[0]), np.float64(p[1]), np.float64(q[0]), np.float64(q[1])
        if py <= y:
            if qy > y and _orient2_sign(px, py, qx, qy, x, y) > 0:
                winding += 1
        elif qy <= y and _orient2_sign(px, py, qx, qy, x, y) < 0:
            winding -= 1
    return winding


@njit(cache=True)
def winding_numbers(positions, faces, order, boxes, points):
    """(winding number (n,) i4, on (n,) bool) of points (n, 3) f8; on: exactly in a face that is not seen edge-on along z.

    positions (v, 3) f4, faces (f, 3) i4: closed, oriented; order, boxes: `bake_boxes.build_boxes` of them. The number of a
    point that is on the mesh is that of one side of it.
    """
    leaves = boxes.shape[0] // 2
    winding = np.zeros(points.shape[0], np.int32)
    on = np.zeros(points.shape[0], np.bool_)
    stack = np.empty(STACK, np.int64)
    for n in range(points.shape[0]):
        x, y, z = points[n, 0], points[n, 1], points[n, 2]
        stack[0], top = 1, 1
        while top > 0:
            top -= 1
            node = stack[top]
            box = boxes[node]
            if x < box[0] or x > box[3] or y < box[1] or y > box[4] or z > box[5]:
                continue
            if node < leaves:
                stack[top], stack[top + 1] = 2 * node, 2 * node + 1
                top += 2
                continue
            start = (node - leaves) * LEAF
            for i in range(start, min(start + LEAF, faces.shape[0])):
                f = order[i]
                a, b, c = positions[faces[f, 0]], positions[faces[f, 1]], positions[faces[f, 2]]
                covering = _covering(a, b, c, x, y)
                if covering == 0:
                    continue
                side = orient_sign(a, b, c, x, y, z, 1.0)
                if side == 0:
                    on[n] = True
                elif side * covering < 0:
                    winding[n] += covering
    return winding, on


@njit(cache=True)
def plane_sides(positions, faces, face, points):
    """(n,) i4: exact side of points (n, 3) f8 of the planes of faces[face], face (n,) i4: 1 outside, 0 on, -1 inside."""
    sides = np.empty(points.shape[0], np.int32)
    for n in range(points.shape[0]):
        f = face[n]
        a, b, c = positions[faces[f, 0]], positions[faces[f, 1]], positions[faces[f, 2]]
        sides[n] = orient_sign(a, b, c, points[n, 0], points[n, 1], points[n, 2], 1.0)
    return sides


@njit(cache=True)
def _crosses(p, q, a, b, c):
    """Whether the segment from p to q has its ends strictly on two sides of the triangle's plane and meets the triangle."""
    first = orient_sign(a, b, c, np.float64(p[0]), np.float64(p[1]), np.float64(p[2]), 1.0)
    if first == 0 or first * orient_sign(a, b, c, np.float64(q[0]), np.float64(q[1]), np.float64(q[2]), 1.0) >= 0:
        return False
    low, high = 0, 0
    for k in range(3):
        s, e = (a, b) if k == 0 else ((b, c) if k == 1 else (c, a))
        turn = orient_sign(p, q, s, np.float64(e[0]), np.float64(e[1]), np.float64(e[2]), 1.0)
        low, high = min(low, turn), max(high, turn)
    return low == 0 or high == 0


@njit(cache=True)
def crossings(positions, faces, order, boxes, starts, ends, pairs):
    """Number of crossings of segments from starts to ends (n, 3) f4 with the mesh; (segment, face) of the first into pairs (m, 2) i4."""
    leaves = boxes.shape[0] // 2
    count = 0
    stack = np.empty(STACK, np.int64)
    for n in range(starts.shape[0]):
        p, q = starts[n], ends[n]
        stack[0], top = 1, 1
        while top > 0:
            top -= 1
            node = stack[top]
            box = boxes[node]
            apart = False
            for k in range(3):
                apart = apart or max(p[k], q[k]) < box[k] or min(p[k], q[k]) > box[3 + k]
            if apart:
                continue
            if node < leaves:
                stack[top], stack[top + 1] = 2 * node, 2 * node + 1
                top += 2
                continue
            start = (node - leaves) * LEAF
            for i in range(start, min(start + LEAF, faces.shape[0])):
                f = order[i]
                if _crosses(p, q, positions[faces[f, 0]], positions[faces[f, 1]], positions[faces[f, 2]]):
                    if count < pairs.shape[0]:
                        pairs[count, 0], pairs[count, 1] = n, f
                    count += 1
    return count


@njit(cache=True)
def without_area(positions, faces):
    """(f,) bool: exactly no area. Along each axis the orientation of the face and a direction is the sign of an area."""
    flat = np.empty(faces.shape[0], np.bool_)
    for f in range(faces.shape[0]):
        a, b, c = positions[faces[f, 0]], positions[faces[f, 1]], positions[faces[f, 2]]
        flat[f] = (
            orient_sign(a, b, c, 1.0, 0.0, 0.0, 0.0) == 0
            and orient_sign(a, b, c, 0.0, 1.0, 0.0, 0.0) == 0
            and orient_sign(a, b, c, 0.0, 0.0, 1.0, 0.0) == 0
        )
    return flat
