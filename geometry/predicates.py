"""The facing rule and the orientation of points, decided exactly: a float filter first, long integers where the filter is unsure.

Every sign of a determinant that changes a result goes through `orient_sign` or `orient2d_sign`; there is no second definition of
"front-facing" anywhere. Based on: Shewchuk 1997 (filter constants of his orient3d and orient2d, stage A); the rule is that of
Silhouette Clipping, section 5. Departure: what the filters leave is decided in integers (`geometry.long_integers`) and not by
floating-point expansions, which cannot hold the product of a denormal and a huge number.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from geometry import long_integers as li
from geometry.borrowing import owning

ORIENT_ERROR = 7.771561172376103e-16
"""(7 + 56 u) u with u = 2^-53: Shewchuk's bound for orient3d evaluated as below, relative to the permanent."""
ORIENT2_ERROR = 3.330669073875472e-16
"""(3 + 16 u) u: the same for orient2d."""
UNDERFLOW_GUARD = 1e-280
"""Products below this may have lost bits to underflow, which the relative bounds do not see."""


@njit(cache=True)
def _bits_of(a, low, high):
    """`long_integers.widen` by all of a (3,)."""
    for k in range(3):
        low, high = li.widen(low, high, np.float64(a[k]))
    return low, high


@owning
def _exact_orient(a, b, c, x, y, z, w):
    """Sign of det[b - a, c - a, (x, y, z) - w a] in long integers; a, b, c: (3,), w is 0 or 1."""
    low, high = _bits_of(a, li.NO_BITS, -li.NO_BITS)
    eye_low, eye_high = (low, high) if w else (li.NO_BITS, -li.NO_BITS)
    low, high = _bits_of(b, low, high)
    low, high = _bits_of(c, low, high)
    eye_low, eye_high = _bits_of((x, y, z), eye_low, eye_high)
    n, m = li.digits_for(low, high), li.digits_for(eye_low, eye_high)
    u, v, d = 0, 3 * (n + li.SPARE), 6 * (n + li.SPARE)
    minor = d + 3 * (m + li.SPARE)
    total = minor + 6 * n
    work = np.zeros(total + 2 * n + m, np.int64)
    for k in range(3):
        li.put_difference(work, u + k * (n + li.SPARE), n, low, np.float64(b[k]), np.float64(a[k]))
        li.put_difference(work, v + k * (n + li.SPARE), n, low, np.float64(c[k]), np.float64(a[k]))
        li.put_difference(work, d + k * (m + li.SPARE), m, eye_low, x if k == 0 else (y if k == 1 else z), w * np.float64(a[k]))
    for k in range(3):
        i, j, own = (k + 1) % 3 * (n + li.SPARE), (k + 2) % 3 * (n + li.SPARE), minor + 2 * n * k
        li.add_product(work, u + i, n, v + j, n, 1, own)
        li.add_product(work, u + j, n, v + i, n, -1, own)
        li.carry(work, own, 2 * n)
        li.add_product(work, own, 2 * n, d + k * (m + li.SPARE), m, 1, total)
    return li.sign_of(work, total, 2 * n + m)


@njit(cache=True, inline="always")
def _filtered_sign(ax, ay, az, bx, by, bz, cx, cy, cz, x, y, z, w):
    """Sign of det[b - a, c - a, (x, y, z) - w a] where f8 is sure of it, else 2."""
    ux, uy, uz = bx - ax, by - ay, bz - az
    vx, vy, vz = cx - ax, cy - ay, cz - az
    dx, dy, dz = x - w * ax, y - w * ay, z - w * az
    p0, p1 = uy * vz, uz * vy
    p2, p3 = uz * vx, ux * vz
    p4, p5 = ux * vy, uy * vx
    det = (p0 - p1) * dx + (p2 - p3) * dy + (p4 - p5) * dz
    permanent = (abs(p0) + abs(p1)) * abs(dx) + (abs(p2) + abs(p3)) * abs(dy) + (abs(p4) + abs(p5)) * abs(dz)
    bound = ORIENT_ERROR * permanent + UNDERFLOW_GUARD
    if det > bound:
        return 1
    if det < -bound:
        return -1
    return 2


@njit(cache=True)
def _same(a, x, y, z):
    return a[0] == x and a[1] == y and a[2] == z


@njit(cache=True)
def _flat(a, b, c, x, y, z, w):
    """Whether two of the points are the same, so that the determinant is zero: where meshes touch, most that float64 cannot tell."""
    if w == 1.0 and (_same(a, x, y, z) or _same(b, x, y, z) or _same(c, x, y, z)):
        return True
    return _same(a, b[0], b[1], b[2]) or _same(b, c[0], c[1], c[2]) or _same(c, a[0], a[1], a[2])


@njit(cache=True)
def orient_sign(a, b, c, x, y, z, w):
    """Exact sign of det[b - a, c - a, (x, y, z) - w a]: 1 when the point is outside the plane of the triangle.

    a, b, c: (3,) f4 or f8, or three f8, counter-clockwise seen from outside. (x, y, z, w): f8 homogeneous point, w 0 or 1.
    Right for all that are finite: denormal and near the largest numbers too.
    """
    sure = _filtered_sign(
        np.float64(a[0]), np.float64(a[1]), np.float64(a[2]),
        np.float64(b[0]), np.float64(b[1]), np.float64(b[2]),
        np.float64(c[0]), np.float64(c[1]), np.float64(c[2]),
        x, y, z, w,
    )  # fmt: skip
    if sure != 2:
        return sure
    return 0 if _flat(a, b, c, x, y, z, w) else _exact_orient(a, b, c, x, y, z, w)


@owning
def _exact_orient2d(ax, ay, bx, by, px, py):
    """As `orient2d_sign`, in long integers."""
    low, high = li.NO_BITS, -li.NO_BITS
    for value in (ax, ay, bx, by, px, py):
        low, high = li.widen(low, high, value)
    n = li.digits_for(low, high)
    stride = n + li.SPARE
    total = 4 * stride
    work = np.zeros(total + 2 * n, np.int64)
    li.put_difference(work, 0, n, low, bx, ax)
    li.put_difference(work, stride, n, low, py, ay)
    li.put_difference(work, 2 * stride, n, low, by, ay)
    li.put_difference(work, 3 * stride, n, low, px, ax)
    li.add_product(work, 0, n, stride, n, 1, total)
    li.add_product(work, 2 * stride, n, 3 * stride, n, -1, total)
    return li.sign_of(work, total, 2 * n)


@njit(cache=True)
def orient2d_sign(ax, ay, bx, by, px, py):
    """Exact sign of det[b - a, p - a] for any finite f8: 1 when p lies left of the line from a to b."""
    left, right = (bx - ax) * (py - ay), (by - ay) * (px - ax)
    det = left - right
    bound = ORIENT2_ERROR * (abs(left) + abs(right)) + UNDERFLOW_GUARD
    if det > bound:
        return 1
    if det < -bound:
        return -1
    return _exact_orient2d(ax, ay, bx, by, px, py)


@njit(cache=True)
def sees_front(positions, i, j, k, eye):
    """Whether the face with the corners i, j, k is front-facing for eye (4,) f8: the point is on or outside the face's plane."""
    sure = _filtered_sign(
        np.float64(positions[i, 0]), np.float64(positions[i, 1]), np.float64(positions[i, 2]),
        np.float64(positions[j, 0]), np.float64(positions[j, 1]), np.float64(positions[j, 2]),
        np.float64(positions[k, 0]), np.float64(positions[k, 1]), np.float64(positions[k, 2]),
        eye[0], eye[1], eye[2], eye[3],
    )  # fmt: skip
    if sure != 2:
        return sure > 0
    return _exact_orient(positions[i], positions[j], positions[k], eye[0], eye[1], eye[2], eye[3]) >= 0


@njit(cache=True)
def is_front_facing(positions, faces, f, eye):
    """As `sees_front`, for face f of faces (f, 3) i4."""
    return sees_front(positions, faces[f, 0], faces[f, 1], faces[f, 2], eye)


@njit(cache=True)
def front_facing(positions, faces, eye):
    """(f,) bool: the facing rule for every face. positions (v, 3) f4, faces (f, 3) i4, eye (4,) f8."""
    front = np.empty(faces.shape[0], np.bool_)
    for f in range(faces.shape[0]):
        front[f] = is_front_facing(positions, faces, f, eye)
    return front
