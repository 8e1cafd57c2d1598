"""Closest point to the origin on the convex hull of a point set.

Based on: Gilbert, Johnson, Keerthi, "A Fast Procedure for Computing the Distance Between Complex Objects in Three-Dimensional
Space" (1988). The simplex is kept at three points: when the hull contains the origin the loop ends at a point whose support
value is not positive, which is what the caller tests. No result depends on full convergence: a cone is verified afterwards.
"""

from __future__ import annotations

from geometry.borrowing import borrowing

_ROUNDS = 48
_RELATIVE = 1e-10


@borrowing
def _segment(ax, ay, az, bx, by, bz):
    """Parameter in [0, 1] of the point of segment ab closest to the origin."""
    dx, dy, dz = bx - ax, by - ay, bz - az
    length = dx * dx + dy * dy + dz * dz
    if length <= 0.0:
        return 0.0
    return min(1.0, max(0.0, -(ax * dx + ay * dy + az * dz) / length))


@borrowing
def _triangle(ax, ay, az, bx, by, bz, cx, cy, cz):
    """Barycentric weights (of a, b, c) of the point of the triangle closest to the origin."""
    abx, aby, abz = bx - ax, by - ay, bz - az
    acx, acy, acz = cx - ax, cy - ay, cz - az
    d1, d2 = -(abx * ax + aby * ay + abz * az), -(acx * ax + acy * ay + acz * az)
    if d1 <= 0.0 and d2 <= 0.0:
        return 1.0, 0.0, 0.0
    d3, d4 = -(abx * bx + aby * by + abz * bz), -(acx * bx + acy * by + acz * bz)
    if d3 >= 0.0 and d4 <= d3:
        return 0.0, 1.0, 0.0
    d5, d6 = -(abx * cx + aby * cy + abz * cz), -(acx * cx + acy * cy + acz * cz)
    if d6 >= 0.0 and d5 <= d6:
        return 0.0, 0.0, 1.0
    vc = d1 * d4 - d3 * d2
    if vc <= 0.0 and d1 >= 0.0 and d3 <= 0.0:
        t = d1 / (d1 - d3) if d1 > d3 else 0.0
        return 1.0 - t, t, 0.0
    vb = d5 * d2 - d1 * d6
    if vb <= 0.0 and d2 >= 0.0 and d6 <= 0.0:
        t = d2 / (d2 - d6) if d2 > d6 else 0.0
        return 1.0 - t, 0.0, t
    va = d3 * d6 - d5 * d4
    if va <= 0.0 and d4 - d3 >= 0.0 and d5 - d6 >= 0.0:
        span = (d4 - d3) + (d5 - d6)
        t = (d4 - d3) / span if span > 0.0 else 0.0
        return 0.0, 1.0 - t, t
    total = va + vb + vc
    if total <= 0.0:
        return 1.0, 0.0, 0.0
    return va / total, vb / total, vc / total


@borrowing
def _closest_on(points, i, j, k):
    """(x, y, z, u, v, w): the point of triangle ijk closest to the origin and its weights."""
    ax, ay, az = points[i, 0], points[i, 1], points[i, 2]
    bx, by, bz = points[j, 0], points[j, 1], points[j, 2]
    cx, cy, cz = points[k, 0], points[k, 1], points[k, 2]
    u, v, w = _triangle(ax, ay, az, bx, by, bz, cx, cy, cz)
    return u * ax + v * bx + w * cx, u * ay + v * by + w * cy, u * az + v * bz + w * cz, u, v, w


@borrowing
def _advance(points, simplex, size, s):
    """Closest point on the simplex grown by point s; rewrites simplex (3,) to the points that carry it."""
    if size == 1:
        i = simplex[0]
        t = _segment(points[i, 0], points[i, 1], points[i, 2], points[s, 0], points[s, 1], points[s, 2])
        x = points[i, 0] + t * (points[s, 0] - points[i, 0])
        y = points[i, 1] + t * (points[s, 1] - points[i, 1])
        z = points[i, 2] + t * (points[s, 2] - points[i, 2])
        if t >= 1.0:
            simplex[0] = s
            return x, y, z, 1
        if t <= 0.0:
            return x, y, z, 1
        simplex[1] = s
        return x, y, z, 2
    best, bx, by, bz, bi, bj, bu, bv, bw = 1e300, 0.0, 0.0, 0.0, simplex[0], simplex[1], 0.0, 0.0, 0.0
    pairs = 1 if size == 2 else 3
    for k in range(pairs):
        i, j = simplex[k], simplex[(k + 1) % size]
        x, y, z, u, v, w = _closest_on(points, i, j, s)
        d = x * x + y * y + z * z
        if d < best:
            best, bx, by, bz, bi, bj, bu, bv, bw = d, x, y, z, i, j, u, v, w
    n = 0
    if bu > 0.0:
        simplex[n] = bi
        n += 1
    if bv > 0.0:
        simplex[n] = bj
        n += 1
    if bw > 0.0:
        simplex[n] = s
        n += 1
    return bx, by, bz, n


@borrowing
def closest_to_origin(points, index, count, simplex):
    """Closest point to the origin on the hull of points[index[:count]]; points (f, 3) f8, index i4, count >= 1.

    Returns (x, y, z, least, size): least is min over the set of point . (x, y, z), positive only when the origin is outside
    the hull; simplex (3,) i4 receives the `size` points that carry the closest point.
    """
    s = index[0]
    simplex[0] = s
    size = 1
    x, y, z = points[s, 0], points[s, 1], points[s, 2]
    least = 0.0
    previous = 1e300
    for _ in range(_ROUNDS):
        least = 1e300
        for i in range(count):
            f = index[i]
            d = points[f, 0] * x + points[f, 1] * y + points[f, 2] * z
            if d < least:
                least, s = d, f
        norm = x * x + y * y + z * z
        if norm - least <= _RELATIVE * norm or norm >= previous or norm < 1e-12:
            break
        previous = norm
        x, y, z, size = _advance(points, simplex, size, s)
    return x, y, z, least, size
