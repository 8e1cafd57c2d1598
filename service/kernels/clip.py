"""Projection of silhouette edges into pixels, with clipping at the eye plane and at the image.

Everything before the last division is homogeneous (u, v, w): u / w and v / w are pixels, v down. A point near the eye plane
is then a direction with a small w instead of a huge number of pixels, and clipping it against the image loses no digits.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from geometry.borrowing import borrowing
from service.kernels.intrinsics import fetch_ahead

EYE_PLANE = 1e-10  # w of the plane that stands in for w = 0, normalised units; float32 positions resolve 6e-8
FAR_PIXELS = 1e6  # a segment that stays within this many pixels of the image needs no clipping to keep its digits
AHEAD = np.uint64(24)  # edges; where the mesh's vertices are in memory nobody can guess, and the caches have others by the next frame
ARC_STEP = np.pi / 3.0  # closing paths bend in steps of 60 degrees, so that no chord comes near the axis


@njit(cache=True, nogil=True)
def homogeneous(m, p):
    """(u, v, w) of a position (3,) f4; m (3, 4) f8 is the pixel matrix."""
    x, y, z = np.float64(p[0]), np.float64(p[1]), np.float64(p[2])
    u = m[0, 0] * x + m[0, 1] * y + m[0, 2] * z + m[0, 3]
    v = m[1, 0] * x + m[1, 1] * y + m[1, 2] * z + m[1, 3]
    w = m[2, 0] * x + m[2, 1] * y + m[2, 2] * z + m[2, 3]
    return u, v, w


@njit(cache=True, nogil=True)
def _emit(out, n, ua, va, wa, ub, vb, wb, width, height):
    """Append the part of a segment (w > 0 at both ends) that the image's rows see.

    Rows above and below drop out; what is right of the image covers nothing and drops out; what is left of it covers whole
    rows and becomes vertical at x = -1.
    """
    low, high = 0.0, 1.0
    for side in range(3):
        if side == 0:
            da, db = va, vb
        elif side == 1:
            da, db = height * wa - va, height * wb - vb
        else:
            da, db = width * wa - ua, width * wb - ub
        if da < 0.0 and db < 0.0:
            return n
        if da < 0.0:
            low = max(low, da / (da - db))
        elif db < 0.0:
            high = min(high, da / (da - db))
    if low >= high:
        return n
    xa, ya = _point(ua, va, wa, ub, vb, wb, low, width, height)
    xb, yb = _point(ua, va, wa, ub, vb, wb, high, width, height)
    da, db = ua + wa, ub + wb
    if (da < 0.0) != (db < 0.0):
        cut = da / (da - db)
        if low < cut < high:
            _, yc = _point(ua, va, wa, ub, vb, wb, cut, width, height)
            n = _put(out, n, max(xa, -1.0), ya, -1.0, yc)
            return _put(out, n, -1.0, yc, max(xb, -1.0), yb)
    return _put(out, n, max(xa, -1.0), ya, max(xb, -1.0), yb)


@njit(cache=True, nogil=True)
def _point(ua, va, wa, ub, vb, wb, t, width, height):
    """Pixel at parameter t; ends exactly, rows and right border held where rounding would leave them."""
    if t == 0.0:
        u, v, w = ua, va, wa
    elif t == 1.0:
        u, v, w = ub, vb, wb
    else:
        u, v, w = ua + t * (ub - ua), va + t * (vb - va), wa + t * (wb - wa)
    return min(u / w, width), min(max(v / w, 0.0), height)


@njit(cache=True, nogil=True)
def _put(out, n, xa, ya, xb, yb):
    out[n, 0], out[n, 1], out[n, 2], out[n, 3] = xa, ya, xb, yb
    return n + 1


@njit(cache=True, nogil=True)
def count_crossings(m, positions, edges):
    """How many edges have one end behind the eye plane."""
    crossing = 0
    for e in range(edges.shape[0]):
        _, _, wa = homogeneous(m, positions[edges[e, 0]])
        _, _, wb = homogeneous(m, positions[edges[e, 1]])
        crossing += (wa < EYE_PLANE) != (wb < EYE_PLANE)
    return crossing


@borrowing
def _in_front(m, positions, edges, first, last, width, height, out):
    n, beyond = first, 0
    for e in range(np.uint64(first), np.uint64(last)):
        ahead = min(e + AHEAD, np.uint64(last - 1))
        fetch_ahead(positions, np.int64(edges[ahead, 0]))
        fetch_ahead(positions, np.int64(edges[ahead, 1]))
        i, j = np.uint64(edges[e, 0]), np.uint64(edges[e, 1])
        x, y, z = np.float64(positions[i, 0]), np.float64(positions[i, 1]), np.float64(positions[i, 2])
        wa = m[2, 0] * x + m[2, 1] * y + m[2, 2] * z + m[2, 3]
        xa = (m[0, 0] * x + m[0, 1] * y + m[0, 2] * z + m[0, 3]) / wa
        ya = (m[1, 0] * x + m[1, 1] * y + m[1, 2] * z + m[1, 3]) / wa
        x, y, z = np.float64(positions[j, 0]), np.float64(positions[j, 1]), np.float64(positions[j, 2])
        wb = m[2, 0] * x + m[2, 1] * y + m[2, 2] * z + m[2, 3]
        xb = (m[0, 0] * x + m[0, 1] * y + m[0, 2] * z + m[0, 3]) / wb
        yb = (m[1, 0] * x + m[1, 1] * y + m[1, 2] * z + m[1, 3]) / wb
        beyond |= not ((wa >= EYE_PLANE) & (wb >= EYE_PLANE) & (max(abs(xa), abs(ya), abs(xb), abs(yb)) < FAR_PIXELS))
        k = np.uint64(n)
        out[k, 0], out[k, 1], out[k, 2], out[k, 3] = xa, ya, xb, yb
        n += (max(ya, yb) >= 0.0) & (min(ya, yb) <= height) & (min(xa, xb) <= width)
    return -1 if beyond else n


@njit(cache=True, nogil=True)
def project_in_front(m, positions, edges, first, last, width, height, out):
    """The segments of edges first..last, written to out (n, 4) f8 from row `first` on; returns the row behind them.

    For when nothing is behind the eye plane and nothing far from the image; otherwise returns -1, and `project_edges` must do it.
    """
    return _in_front(m, positions, edges, first, last, width, height, out)


@njit(cache=True, nogil=True)
def project_edges(m, positions, edges, width, height, out, cuts):
    """(segments written to out (n, 4) f8, crossings written to cuts (k, 3) f8).

    cuts: u, v at the eye plane and the sign: +1 where a contour comes into view, -1 where it leaves.
    """
    n, k = 0, 0
    for e in range(edges.shape[0]):
        ua, va, wa = homogeneous(m, positions[edges[e, 0]])
        ub, vb, wb = homogeneous(m, positions[edges[e, 1]])
        if wa < EYE_PLANE or wb < EYE_PLANE:
            if wa < EYE_PLANE and wb < EYE_PLANE:
                continue
            t = (EYE_PLANE - wa) / (wb - wa)
            u, v = ua + t * (ub - ua), va + t * (vb - va)
            cuts[k, 0], cuts[k, 1] = u, v
            cuts[k, 2] = 1.0 if wa < EYE_PLANE else -1.0
            k += 1
            if wa < EYE_PLANE:
                ua, va, wa = u, v, EYE_PLANE
            else:
                ub, vb, wb = u, v, EYE_PLANE
        xa, ya, xb, yb = ua / wa, va / wa, ub / wb, vb / wb
        if max(abs(xa), abs(ya), abs(xb), abs(yb)) < FAR_PIXELS:
            if max(ya, yb) >= 0.0 and min(ya, yb) <= height and min(xa, xb) <= width:
                n = _put(out, n, xa, ya, xb, yb)
        else:
            n = _emit(out, n, ua, va, wa, ub, vb, wb, width, height)
    return n, k


@njit(cache=True, nogil=True)
def hub_of(cuts, width, height):
    """(angle, radius) of the point all closing paths run through: the mean direction of the cuts, at their largest distance.

    Measured in the eye plane, in units in which the image is the square of half side EYE_PLANE about the axis.
    """
    x, y, farthest = 0.0, 0.0, 0.0
    for k in range(cuts.shape[0]):
        a, b = _centred(cuts[k, 0], cuts[k, 1], width, height)
        length = np.hypot(a, b)
        farthest = max(farthest, length)
        if length > 0.0:
            x += a / length
            y += b / length
    return np.arctan2(y, x), farthest


@njit(cache=True, nogil=True)
def _centred(u, v, width, height):
    return u / (0.5 * width) - EYE_PLANE, v / (0.5 * height) - EYE_PLANE


@njit(cache=True, nogil=True)
def closing_path(u, v, angle, radius, width, height, path):
    """Points from a cut (u, v) to the hub along the shorter way round the axis, into path (5, 2); returns how many.

    u, v of the eye plane; the first point is the cut itself, the last the hub.
    """
    a, b = _centred(u, v, width, height)
    start, length = np.arctan2(b, a), np.hypot(a, b)
    turn = (angle - start + np.pi) % (2.0 * np.pi) - np.pi
    steps = max(1, int(np.ceil(abs(turn) / ARC_STEP)))
    path[0, 0], path[0, 1] = u, v
    for i in range(1, steps + 1):
        # the hub from its own numbers, so that all paths end in the same point
        r = radius if i == steps else length + i / steps * (radius - length)
        phi = angle if i == steps else start + i / steps * turn
        path[i, 0] = (r * np.cos(phi) + EYE_PLANE) * (0.5 * width)
        path[i, 1] = (r * np.sin(phi) + EYE_PLANE) * (0.5 * height)
    return steps + 1


@njit(cache=True, nogil=True)
def close_cuts(cuts, width, height, out, n):
    """Append to out, from n on, paths that join every cut to the hub; returns the new n."""
    angle, radius = hub_of(cuts, width, height)
    path = np.empty((5, 2))
    w = EYE_PLANE
    for k in range(cuts.shape[0]):
        count = closing_path(cuts[k, 0], cuts[k, 1], angle, radius, width, height, path)
        for i in range(count - 1):
            a, b = (i, i + 1) if cuts[k, 2] < 0.0 else (i + 1, i)
            n = _emit(out, n, path[a, 0], path[a, 1], w, path[b, 0], path[b, 1], w, width, height)
    return n
