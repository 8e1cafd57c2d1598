"""What stands in the way of a hull's vertex that moves inwards: triangles of the original inside the tetrahedra it sweeps.

A vertex v of the hull that moves to w takes from the hull, below each face (v, a, b) of its fan, the tetrahedron (v, a, b, w).
The hull goes on enclosing the original when no triangle of it has a point in the open tetrahedron, and the tetrahedron lies
outside of it. Touching is allowed: hulls rest on vertices of the original. A triangle is let pass when a plane separates the two
weakly: one of a face of either, decided exactly, or one along an edge of each with room to spare; others count as in the way.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from geometry.borrowing import borrowing
from geometry.boxes import LEAF, boxes_meet
from geometry.predicates import UNDERFLOW_GUARD, orient_sign

ROOM = 1e-13
"""Normalised units between two shadows on an axis that float64 cannot have made up."""
HEIGHT_ERROR = 1e-14
"""Of a height over a plane, over the products in it: some 20 roundings of 2^-53, and as much again."""
MOST_CORNERS = 8
"""Corners of a triangle cut by the four planes of a tetrahedron, 7, and one."""
PLANES = ((3, 1, 2, 1), (0, 1, 2, -1), (0, 3, 1, -1), (0, 2, 3, -1))
"""Faces of the tetrahedron (v, a, b, w), w below (v, a, b): corners, and the sign of its inside."""
EDGES = ((0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3))


class Search(NamedTuple):
    """Scratch of one search. stack: (STACK,) i8. planes: (4, 5) f8. reach: (6,) f8, a box."""

    stack: np.ndarray
    planes: np.ndarray
    reach: np.ndarray


@borrowing
def copy_point(point, into):
    """As into[:] = point, which would make room for a copy."""
    for k in range(3):
        into[k] = point[k]


@borrowing
def copy_points(points, count, into):
    """As into[:count] = points[:count]."""
    for n in range(count):
        copy_point(points[n], into[n])


@borrowing
def _measure_planes(tet, planes):
    """planes (4, 5) f8 of the tetrahedron: normal towards its inside, offset, error of a height in it that float64 may make."""
    farthest = 1.0
    for k in range(4):
        farthest = max(farthest, abs(tet[k, 0]), abs(tet[k, 1]), abs(tet[k, 2]))
    for n in range(4):
        p, q, r, inside = PLANES[n]
        ux, uy, uz = tet[q, 0] - tet[p, 0], tet[q, 1] - tet[p, 1], tet[q, 2] - tet[p, 2]
        wx, wy, wz = tet[r, 0] - tet[p, 0], tet[r, 1] - tet[p, 1], tet[r, 2] - tet[p, 2]
        nx, ny, nz = inside * (uy * wz - uz * wy), inside * (uz * wx - ux * wz), inside * (ux * wy - uy * wx)
        size = abs(uy * wz) + abs(uz * wy) + abs(uz * wx) + abs(ux * wz) + abs(ux * wy) + abs(uy * wx)
        planes[n, 0], planes[n, 1], planes[n, 2] = nx, ny, nz
        planes[n, 3] = nx * tet[p, 0] + ny * tet[p, 1] + nz * tet[p, 2]
        planes[n, 4] = HEIGHT_ERROR * size * farthest + UNDERFLOW_GUARD


@borrowing
def _box_beyond(planes, box):
    """Whether a plane has the whole box surely on its other side."""
    for n in range(4):
        nx, ny, nz = planes[n, 0], planes[n, 1], planes[n, 2]
        highest = nx * (box[3] if nx > 0.0 else box[0]) + ny * (box[4] if ny > 0.0 else box[1]) + nz * (box[5] if nz > 0.0 else box[2])
        if highest - planes[n, 3] < -planes[n, 4]:
            return True
    return False


@borrowing
def _beyond_a_face(tet, planes, tri):
    """Whether the plane of a face of the tetrahedron has the whole triangle on its other side, or in it."""
    for n in range(4):
        p, q, r, inside = PLANES[n]
        beyond = True
        for k in range(3):
            height = planes[n, 0] * tri[k, 0] + planes[n, 1] * tri[k, 1] + planes[n, 2] * tri[k, 2] - planes[n, 3]
            if height < -planes[n, 4]:
                continue
            if height > planes[n, 4] or orient_sign(tet[p], tet[q], tet[r], tri[k, 0], tri[k, 1], tri[k, 2], 1.0) * inside > 0:
                beyond = False
                break
        if beyond:
            return True
    return False


@borrowing
def _on_one_side(tet, tri):
    """Whether the triangle's plane has the whole tetrahedron on one side."""
    above, below = False, False
    for k in range(4):
        sign = orient_sign(tri[0], tri[1], tri[2], tet[k, 0], tet[k, 1], tet[k, 2], 1.0)
        above, below = above or sign > 0, below or sign < 0
    return not (above and below)


@borrowing
def _apart_along_edges(tet, tri):
    """Whether the shadows on the normal of an edge of each are apart by ROOM."""
    for p, q in EDGES:
        ux, uy, uz = tet[q, 0] - tet[p, 0], tet[q, 1] - tet[p, 1], tet[q, 2] - tet[p, 2]
        for i in range(3):
            j = (i + 1) % 3
            wx, wy, wz = tri[j, 0] - tri[i, 0], tri[j, 1] - tri[i, 1], tri[j, 2] - tri[i, 2]
            nx, ny, nz = uy * wz - uz * wy, uz * wx - ux * wz, ux * wy - uy * wx
            length = math.sqrt(nx * nx + ny * ny + nz * nz)
            if length == 0.0:
                continue
            low, high = np.inf, -np.inf
            for k in range(4):
                s = nx * tet[k, 0] + ny * tet[k, 1] + nz * tet[k, 2]
                low, high = min(low, s), max(high, s)
            least, most = np.inf, -np.inf
            for k in range(3):
                s = nx * tri[k, 0] + ny * tri[k, 1] + nz * tri[k, 2]
                least, most = min(least, s), max(most, s)
            if max(least - high, low - most) > ROOM * length:
                return True
    return False


@borrowing
def _clip(tet, planes, tri, polygon, other):
    """The part of the triangle in the tetrahedron, rounded, into polygon (MOST_CORNERS, 3); returns its corners."""
    n = 3
    copy_points(tri, 3, polygon)
    for side in range(4):
        p = PLANES[side][0]
        nx, ny, nz = planes[side, 0], planes[side, 1], planes[side, 2]
        m = 0
        for k in range(n):
            j = k + 1 if k + 1 < n else 0
            here = nx * (polygon[k, 0] - tet[p, 0]) + ny * (polygon[k, 1] - tet[p, 1]) + nz * (polygon[k, 2] - tet[p, 2])
            there = nx * (polygon[j, 0] - tet[p, 0]) + ny * (polygon[j, 1] - tet[p, 1]) + nz * (polygon[j, 2] - tet[p, 2])
            if here >= 0.0 and m < MOST_CORNERS:
                copy_point(polygon[k], other[m])
                m += 1
            if here * there < 0.0 and m < MOST_CORNERS:
                t = here / (here - there)
                for axis in range(3):
                    other[m, axis] = polygon[k, axis] + t * (polygon[j, axis] - polygon[k, axis])
                m += 1
        n = m
        copy_points(other, n, polygon)
        if n == 0:
            return 0
    return n


@borrowing
def _angle(tet, q):
    """Angle about the edge (a, b) from the new face (w, a, b) up to the point q; larger is worse."""
    bx, by, bz = tet[2, 0] - tet[1, 0], tet[2, 1] - tet[1, 1], tet[2, 2] - tet[1, 2]
    wx, wy, wz = tet[3, 0] - tet[1, 0], tet[3, 1] - tet[1, 1], tet[3, 2] - tet[1, 2]
    # the new face's normal is (a - w) x (b - w) = (b - a) x (w - a), and normal x (b - a) points from the edge to w
    nx, ny, nz = by * wz - bz * wy, bz * wx - bx * wz, bx * wy - by * wx
    ix, iy, iz = ny * bz - nz * by, nz * bx - nx * bz, nx * by - ny * bx
    x, y, z = q[0] - tet[1, 0], q[1] - tet[1, 1], q[2] - tet[1, 2]
    edge = math.sqrt(bx * bx + by * by + bz * bz)
    return math.atan2((nx * x + ny * y + nz * z) * edge, ix * x + iy * y + iz * z)


@borrowing
def obstacle(original, order, boxes, tet, scratch, worst, search):
    """Whether triangles of the original have points in the open tetrahedron (4, 3) f8 (v, a, b, w), w exactly below (v, a, b).

    original (f, 3, 3) f8 corners with float32 values; order, boxes: `geometry.boxes.build_boxes` of it. scratch: (2, MOST_CORNERS, 3)
    f8. Returns (0 free, 1 in the way, 2 in the way and worst (3,) f8 is the point the new face must be turned outwards to).
    """
    stack, planes, reach = search
    _measure_planes(tet, planes)
    for k in range(3):
        reach[k] = min(tet[0, k], tet[1, k], tet[2, k], tet[3, k])
        reach[3 + k] = max(tet[0, k], tet[1, k], tet[2, k], tet[3, k])
    leaves = boxes.shape[0] // 2
    stack[0], top = 1, 1
    state, steepest = 0, 1e-9
    while top > 0:
        top -= 1
        node = stack[top]
        if not boxes_meet(reach, boxes[node]) or _box_beyond(planes, boxes[node]):
            continue
        if node < leaves:
            stack[top], stack[top + 1] = 2 * node, 2 * node + 1
            top += 2
            continue
        leaf = node - leaves
        for i in range(leaf * LEAF, min(leaf * LEAF + LEAF, order.shape[0])):
            tri = original[order[i]]
            if _beyond_a_face(tet, planes, tri) or _on_one_side(tet, tri) or _apart_along_edges(tet, tri):
                continue
            state = max(state, 1)
            for k in range(_clip(tet, planes, tri, scratch[0], scratch[1])):
                angle = _angle(tet, scratch[0, k])
                if angle > steepest:
                    steepest, state = angle, 2
                    copy_point(scratch[0, k], worst)
    return state
