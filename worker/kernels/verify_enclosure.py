"""Winding numbers and crossings of triangle meshes, decided exactly: what proves that a hull encloses its original.

The winding number of a point counts the faces above it, along +z: plus one for a face that is left upwards there, minus one
for a face that is entered. Which faces lie above is decided in the xy plane by a half-open rule, so that a ray through an
edge or a vertex of the mesh counts each sheet of the surface once, and in height by the exact orientation.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from geometry.borrowing import borrowing
from geometry.boxes import LEAF, STACK, next_leaf
from geometry.predicates import UNDERFLOW_GUARD, orient2d_sign, orient_sign

BESIDE_ERROR = 1e-14  # of a plane's value at a point, over the product of absolute values in it: some 20 roundings of 2^-53


@borrowing
def _covering(a, b, c, x, y):
    """How often the triangle, seen along z, winds about (x, y): 1 counter-clockwise, -1 clockwise, 0 outside."""
    winding = 0
    for k in range(3):
        p, q = (a, b) if k == 0 else ((b, c) if k == 1 else (c, a))
        px, py, qx, qy = np.float64(p[0]), np.float64(p[1]), np.float64(q[0]), np.float64(q[1])
        if py <= y:
            if qy > y and orient2d_sign(px, py, qx, qy, x, y) > 0:
                winding += 1
        elif qy <= y and orient2d_sign(px, py, qx, qy, x, y) < 0:
            winding -= 1
    return winding


@borrowing
def winding_number(positions, faces, order, boxes, point, stack, above):
    """(winding number, on) of one point (3,) f8, as below. stack (STACK,) i8, above (6,) f8: scratch."""
    x, y, z = point[0], point[1], point[2]
    above[0], above[1], above[2], above[3], above[4], above[5] = x, y, z, x, y, np.inf
    stack[0], top = 1, 1
    winding, on = 0, False
    while True:
        leaf, top = next_leaf(boxes, above, stack, top)
        if leaf < 0:
            return winding, on
        for i in range(leaf * LEAF, min(leaf * LEAF + LEAF, faces.shape[0])):
            f = order[i]
            a, b, c = positions[faces[f, 0]], positions[faces[f, 1]], positions[faces[f, 2]]
            covering = _covering(a, b, c, x, y)
            if covering == 0:
                continue
            side = orient_sign(a, b, c, x, y, z, 1.0)
            if side == 0:
                on = True
            elif side * covering < 0:
                winding += covering


@njit(cache=True, nogil=True)
def winding_numbers(positions, faces, order, boxes, points):
    """(winding number (n,) i4, on (n,) bool) of points (n, 3) f8; on: exactly in a face that is not seen edge-on along z.

    positions (v, 3) f4, faces (f, 3) i4: closed, oriented; order, boxes: `geometry.boxes.build_boxes` of them. The number of a
    point that is on the mesh is that of one side of it.
    """
    winding = np.zeros(points.shape[0], np.int32)
    on = np.zeros(points.shape[0], np.bool_)
    stack, above = np.empty(STACK, np.int64), np.empty(6)
    for n in range(points.shape[0]):
        winding[n], on[n] = winding_number(positions, faces, order, boxes, points[n], stack, above)
    return winding, on


@njit(cache=True, nogil=True)
def plane_sides(positions, faces, face, points):
    """(n,) i4: exact side of points (n, 3) f8 of the planes of faces[face], face (n,) i4: 1 outside, 0 on, -1 inside."""
    sides = np.empty(points.shape[0], np.int32)
    for n in range(points.shape[0]):
        f = face[n]
        a, b, c = positions[faces[f, 0]], positions[faces[f, 1]], positions[faces[f, 2]]
        sides[n] = orient_sign(a, b, c, points[n, 0], points[n, 1], points[n, 2], 1.0)
    return sides


@borrowing
def _side(a, b, c, p):
    """Exact side of the plane through a, b, c on which p lies: 1 outside, 0 on, -1 inside."""
    return orient_sign(a, b, c, np.float64(p[0]), np.float64(p[1]), np.float64(p[2]), 1.0)


@borrowing
def _through(p, q, a, b, c):
    """Whether the segment from p to q, whose ends are strictly on two sides of the triangle's plane, meets the triangle."""
    low, high = 0, 0
    for k in range(3):
        s, e = (a, b) if k == 0 else ((b, c) if k == 1 else (c, a))
        turn = _side(p, q, s, e)
        low, high = min(low, turn), max(high, turn)
    return low == 0 or high == 0


@borrowing
def _crosses(p, q, a, b, c):
    """Whether the segment from p to q has its ends strictly on two sides of the triangle's plane and meets the triangle."""
    first = _side(a, b, c, p)
    return first != 0 and first * _side(a, b, c, q) < 0 and _through(p, q, a, b, c)


@borrowing
def _box_meets_triangle_box(box, a, b, c):
    """Whether a box (6,) has a point in common with the box about a triangle; exact where all are float32."""
    apart = max(a[0], b[0], c[0]) < box[0] or min(a[0], b[0], c[0]) > box[3] or max(a[1], b[1], c[1]) < box[1]
    apart = apart or min(a[1], b[1], c[1]) > box[4] or max(a[2], b[2], c[2]) < box[2]
    return not (apart or min(a[2], b[2], c[2]) > box[5])


@borrowing
def _plane(a, b, c, reach, plane):
    """Plane through a, b, c into plane (5,) f8: normal, offset, and by what its value may be off where no coordinate exceeds reach."""
    ax, ay, az = np.float64(a[0]), np.float64(a[1]), np.float64(a[2])
    ux, uy, uz, vx, vy, vz = b[0] - ax, b[1] - ay, b[2] - az, c[0] - ax, c[1] - ay, c[2] - az
    plane[0], plane[1], plane[2] = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    plane[3] = -(plane[0] * ax + plane[1] * ay + plane[2] * az)
    plane[4] = 8.0 * BESIDE_ERROR * reach * (abs(ux) + abs(uy) + abs(uz)) * (abs(vx) + abs(vy) + abs(vz)) + UNDERFLOW_GUARD


@borrowing
def _beside(plane, p, q):
    """Whether p and q are certainly strictly on the same side of a plane of `_plane`."""
    first = plane[0] * p[0] + plane[1] * p[1] + plane[2] * p[2] + plane[3]
    last = plane[0] * q[0] + plane[1] * q[1] + plane[2] * q[2] + plane[3]
    return (first > plane[4] and last > plane[4]) or (first < -plane[4] and last < -plane[4])


@borrowing
def _shares_corner(p, q, a, b, c):
    """Whether p or q is a corner of the triangle: it is on the plane then, and about a vertex of many edges most are."""
    shared = False
    for s in (p, q):
        shared |= (s[0] == a[0] and s[1] == a[1] and s[2] == a[2]) or (s[0] == b[0] and s[1] == b[1] and s[2] == b[2])
        shared |= s[0] == c[0] and s[1] == c[1] and s[2] == c[2]
    return shared


@borrowing
def _crossings_of(n, p, q, corners, planes, order, boxes, pairs, count, stack, about):
    """count and the crossings of segment n, from p to q; corners (f, 3, 3) f4 and planes (f, 5) f8 in the order of the leaves;
    stack (STACK,) i8, about (6,) f8: scratch."""
    for k in range(3):
        about[k], about[3 + k] = min(p[k], q[k]), max(p[k], q[k])
    stack[0], top = 1, 1
    while True:
        leaf, top = next_leaf(boxes, about, stack, top)
        if leaf < 0:
            return count
        for i in range(leaf * LEAF, min(leaf * LEAF + LEAF, order.shape[0])):
            if _beside(planes[i], p, q):
                continue
            a, b, c = corners[i, 0], corners[i, 1], corners[i, 2]
            if _box_meets_triangle_box(about, a, b, c) and not _shares_corner(p, q, a, b, c) and _crosses(p, q, a, b, c):
                if count < pairs.shape[0]:
                    pairs[count, 0], pairs[count, 1] = n, order[i]
                count += 1


@njit(cache=True, nogil=True)
def crossings(positions, faces, order, boxes, starts, ends, pairs, most):
    """Number of crossings of segments from starts to ends (n, 3) f4 with the mesh; (segment, face) of the first into pairs (m, 2) i4.

    It ends with the segment with which they come to more than `most`.
    """
    count = 0
    stack, about = np.empty(STACK, np.int64), np.empty(6)
    corners, planes = np.empty((order.shape[0], 3, 3), np.float32), np.empty((order.shape[0], 5))
    reach = 0.0
    for points in (positions, starts, ends):
        for n in range(points.shape[0]):
            reach = max(reach, abs(points[n, 0]), abs(points[n, 1]), abs(points[n, 2]))
    for i in range(order.shape[0]):
        for k in range(3):
            corners[i, k] = positions[faces[order[i], k]]
        _plane(corners[i, 0], corners[i, 1], corners[i, 2], reach, planes[i])
    for n in range(starts.shape[0]):
        count = _crossings_of(n, starts[n], ends[n], corners, planes, order, boxes, pairs, count, stack, about)
        if count > most:
            break
    return count


@borrowing
def _box_beside_plane(box, a, b, c):
    """Whether a box (6,) f4 is certainly strictly on one side of the plane through a, b, c."""
    ax, ay, az = np.float64(a[0]), np.float64(a[1]), np.float64(a[2])
    ux, uy, uz, vx, vy, vz = b[0] - ax, b[1] - ay, b[2] - az, c[0] - ax, c[1] - ay, c[2] - az
    nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    rx, ry, rz = 0.5 * (np.float64(box[3]) - box[0]), 0.5 * (np.float64(box[4]) - box[1]), 0.5 * (np.float64(box[5]) - box[2])
    x, y, z = box[0] + rx - ax, box[1] + ry - ay, box[2] + rz - az
    size = (abs(ux) + abs(uy) + abs(uz)) * (abs(vx) + abs(vy) + abs(vz))
    margin = BESIDE_ERROR * size * (abs(x) + abs(y) + abs(z) + rx + ry + rz)
    return abs(nx * x + ny * y + nz * z) > abs(nx) * rx + abs(ny) * ry + abs(nz) * rz + margin


@borrowing
def _boxes_apart(p, q, r, a, b, c):
    apart = False
    for k in range(3):
        apart |= max(p[k], q[k], r[k]) < min(a[k], b[k], c[k]) or min(p[k], q[k], r[k]) > max(a[k], b[k], c[k])
    return apart


@borrowing
def _sides_apart(p, q, r, a, b, c, sp, sq, sr):
    """Whether no side of triangle p, q, r meets triangle a, b, c, for sure; sp, sq, sr: where its corners are of that plane."""
    if sp * sq <= 0 and (sp * sq == 0 or _through(p, q, a, b, c)):
        return False
    if sq * sr <= 0 and (sq * sr == 0 or _through(q, r, a, b, c)):
        return False
    return not (sr * sp <= 0 and (sr * sp == 0 or _through(r, p, a, b, c)))


@borrowing
def _apart(p, q, r, a, b, c):
    """Whether two triangles have certainly, exactly, no point in common: where two meet, a side of one meets the other."""
    if _boxes_apart(p, q, r, a, b, c):
        return True
    sp, sq, sr = _side(a, b, c, p), _side(a, b, c, q), _side(a, b, c, r)
    if sp != 0 and sp == sq and sq == sr:
        return True
    sa, sb, sc = _side(p, q, r, a), _side(p, q, r, b), _side(p, q, r, c)
    if sa != 0 and sa == sb and sb == sc:
        return True
    return _sides_apart(p, q, r, a, b, c, sp, sq, sr) and _sides_apart(a, b, c, p, q, r, sa, sb, sc)


@borrowing
def _contacts_of(
    start, box, positions, faces, order, other_positions, other_faces, other_order, other_boxes, touched, other_touched, stack
):
    """What `contacts` marks for the faces of one leaf, from `start` on, with this box (6,) f4; stack (STACK,) i8: scratch."""
    stack[0], top = 1, 1
    while True:
        leaf, top = next_leaf(other_boxes, box, stack, top)
        if leaf < 0:
            return
        for j in range(leaf * LEAF, min(leaf * LEAF + LEAF, other_faces.shape[0])):
            g = other_order[j]
            a, b, c = other_positions[other_faces[g, 0]], other_positions[other_faces[g, 1]], other_positions[other_faces[g, 2]]
            if not _box_meets_triangle_box(box, a, b, c) or _box_beside_plane(box, a, b, c):
                continue
            for i in range(start, min(start + LEAF, faces.shape[0])):
                f = order[i]
                if touched[f] and other_touched[g]:
                    continue
                p, q, r = positions[faces[f, 0]], positions[faces[f, 1]], positions[faces[f, 2]]
                if not _apart(p, q, r, a, b, c):
                    touched[f], other_touched[g] = True, True


@njit(cache=True, nogil=True)
def contacts(positions, faces, order, boxes, other_positions, other_faces, other_order, other_boxes, touched, other_touched):
    """Mark every face of either of two meshes that may meet the other: touched (f,) bool, other_touched (g,) bool.

    A face that is not marked has no point in common with the other mesh, exactly. One that is marked may have none either, when
    a corner or a side of the one lies in the plane of the other.
    """
    stack = np.empty(STACK, np.int64)
    first = boxes.shape[0] // 2
    other = (other_positions, other_faces, other_order, other_boxes)
    for start in range(0, faces.shape[0], LEAF):
        _contacts_of(start, boxes[first + start // LEAF], positions, faces, order, *other, touched, other_touched, stack)


@njit(cache=True, nogil=True)
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
