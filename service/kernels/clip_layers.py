"""Layers over one point of the image: counted on the faces, and on the projected edges."""

from __future__ import annotations

from numba import njit

from service.kernels.clip import homogeneous


@njit(cache=True, nogil=True)
def front_layers(m, positions, faces, px, py):
    """Front-facing faces in front of the eye that the ray through pixel coordinates (px, py) meets. m (3, 4) f8: pixel matrix.

    Seen along the ray every point is (u - px w, v - py w): a linear map, whatever lies behind the eye.
    """
    count = 0
    for f in range(faces.shape[0]):
        ua, va, wa = homogeneous(m, positions[faces[f, 0]])
        ub, vb, wb = homogeneous(m, positions[faces[f, 1]])
        uc, vc, wc = homogeneous(m, positions[faces[f, 2]])
        ua, va, ub, vb, uc, vc = ua - px * wa, va - py * wa, ub - px * wb, vb - py * wb, uc - px * wc, vc - py * wc
        # v is down: counter-clockwise as seen is a negative area here
        c, a, b = va * ub - ua * vb, vb * uc - ub * vc, vc * ua - uc * va
        if a > 0.0 and b > 0.0 and c > 0.0 and a * wa + b * wb + c * wc > 0.0:
            count += 1
    return count


@njit(cache=True, nogil=True)
def winding(segments, px, py):
    """Winding number of segments (s, 4) about a point: edges left of it that run down, less those that run up."""
    total = 0
    for s in range(segments.shape[0]):
        xa, ya, xb, yb = segments[s, 0], segments[s, 1], segments[s, 2], segments[s, 3]
        if (ya <= py) != (yb <= py) and xa + (py - ya) * ((xb - xa) / (yb - ya)) < px:
            total += 1 if yb > ya else -1
    return total
