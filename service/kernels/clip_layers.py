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


@njit(cache=True, nogil=True)
def _beside(ax, ay, az, bx, by, bz):
    """Squared distance of the origin to the segment from a to b."""
    ux, uy, uz = bx - ax, by - ay, bz - az
    length = ux * ux + uy * uy + uz * uz
    t = min(max(-(ax * ux + ay * uy + az * uz) / length, 0.0), 1.0) if length > 0.0 else 0.0
    return (ax + t * ux) ** 2 + (ay + t * uy) ** 2 + (az + t * uz) ** 2


@njit(cache=True, nogil=True)
def touches(positions, faces, eye, within):
    """Whether the eye (4,) f8, w = 1, is at most `within` from one of the faces (f, 3) i4 of positions (v, 3) f4."""
    for f in range(faces.shape[0]):
        i, j, k = faces[f, 0], faces[f, 1], faces[f, 2]
        ax, ay, az = positions[i, 0] - eye[0], positions[i, 1] - eye[1], positions[i, 2] - eye[2]
        bx, by, bz = positions[j, 0] - eye[0], positions[j, 1] - eye[1], positions[j, 2] - eye[2]
        cx, cy, cz = positions[k, 0] - eye[0], positions[k, 1] - eye[1], positions[k, 2] - eye[2]
        if min(ax, bx, cx) > within or max(ax, bx, cx) < -within or min(ay, by, cy) > within or max(ay, by, cy) < -within:
            continue
        sides = min(_beside(ax, ay, az, bx, by, bz), _beside(bx, by, bz, cx, cy, cz), _beside(cx, cy, cz, ax, ay, az))
        if sides <= within * within:
            return True
        ux, uy, uz, vx, vy, vz = bx - ax, by - ay, bz - az, cx - ax, cy - ay, cz - az
        nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
        height, square = ax * nx + ay * ny + az * nz, nx * nx + ny * ny + nz * nz
        # parts of the corners in the foot of the perpendicular from the eye
        p = nx * (by * cz - bz * cy) + ny * (bz * cx - bx * cz) + nz * (bx * cy - by * cx)
        q = nx * (cy * az - cz * ay) + ny * (cz * ax - cx * az) + nz * (cx * ay - cy * ax)
        r = nx * (ay * bz - az * by) + ny * (az * bx - ax * bz) + nz * (ax * by - ay * bx)
        if min(p, q, r) >= 0.0 and height * height <= within * within * square:
            return True
    return False
