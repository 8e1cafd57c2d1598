"""The facing rule, decided exactly: a float filter first, floating-point expansions where the filter is unsure.

Every sign that changes a result goes through `orient_sign`; there is no second definition of "front-facing" anywhere.
Based on: Shewchuk 1997 (filter constant of his orient3d, stage A); the rule is that of Silhouette Clipping, section 5.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from geometry import expansions as ex
from geometry.borrowing import owning

# (7 + 56 u) u with u = 2^-53: Shewchuk's bound for orient3d evaluated as below, relative to the permanent
ORIENT_ERROR = 7.771561172376103e-16
# products below this may have lost bits to underflow, which the relative bound does not see
UNDERFLOW_GUARD = 1e-280
_RAISE, _RAISABLE = 2.0**500, 2.0**400


@owning
def _exact_orient(a, b, c, x, y, z, w):
    """Sign of det[b - a, c - a, (x, y, z) - w a] by expansions; a, b, c: (3,), w is 0 or 1."""
    ux, nux = ex.difference(np.float64(b[0]), np.float64(a[0]))
    uy, nuy = ex.difference(np.float64(b[1]), np.float64(a[1]))
    uz, nuz = ex.difference(np.float64(b[2]), np.float64(a[2]))
    vx, nvx = ex.difference(np.float64(c[0]), np.float64(a[0]))
    vy, nvy = ex.difference(np.float64(c[1]), np.float64(a[1]))
    vz, nvz = ex.difference(np.float64(c[2]), np.float64(a[2]))
    # the sign is that of any positive multiple of the last column: raised, the smallest eyes do not underflow
    s = _RAISE if max(abs(x), abs(y), abs(z)) < _RAISABLE else 1.0
    dx, ndx = ex.difference(x * s, np.float64(a[0]) * w * s)
    dy, ndy = ex.difference(y * s, np.float64(a[1]) * w * s)
    dz, ndz = ex.difference(z * s, np.float64(a[2]) * w * s)
    total = np.empty(200)
    n = _add_minor_product(total, 0, uy, nuy, vz, nvz, uz, nuz, vy, nvy, dx, ndx)
    n = _add_minor_product(total, n, uz, nuz, vx, nvx, ux, nux, vz, nvz, dy, ndy)
    n = _add_minor_product(total, n, ux, nux, vy, nvy, uy, nuy, vx, nvx, dz, ndz)
    return ex.sign(total, n)


@njit(cache=True)
def _add_minor_product(total, n, a, na, b, nb, c, nc, d, nd, f, nf):
    """total += (a b - c d) f, all expansions."""
    minor = np.empty(16)
    k = ex.multiply(a, na, b, nb, minor)
    other = np.empty(8)
    m = ex.multiply(c, nc, d, nd, other)
    for i in range(m):
        other[i] = -other[i]
    k = ex.add(minor, k, other, m)
    product = np.empty(64)
    p = ex.multiply(minor, k, f, nf, product)
    return ex.add(total, n, product, p)


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

    a, b, c: (3,) f4 or f8, counter-clockwise seen from outside. (x, y, z, w): f8 homogeneous point, w 0 or 1.
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


@njit(cache=True)
def is_front_facing(positions, faces, f, eye):
    """Whether face f is front-facing for eye (4,) f8: the point is on or outside the face's plane."""
    i, j, k = faces[f, 0], faces[f, 1], faces[f, 2]
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
def front_facing(positions, faces, eye):
    """(f,) bool: the facing rule for every face. positions (v, 3) f4, faces (f, 3) i4, eye (4,) f8."""
    front = np.empty(faces.shape[0], np.bool_)
    for f in range(faces.shape[0]):
        front[f] = is_front_facing(positions, faces, f, eye)
    return front
