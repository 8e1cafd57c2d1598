"""Anchored cones of a face cluster: axis, opening, both anchors, and how likely an eye is in neither.

Based on: Silhouette Clipping, section 5. The axis is the closest point to the origin on the hull of the normals; the opening
is the complement of the largest angle to a normal; the anchors are linear programs.

Departures. Every cone is *verified* against every face with the margins below, and moved until it passes, so that neither
the accuracy of the closest point nor of the linear program matters for soundness. The linear program has a known dual
feasible start (the axis lies inside the cone of the normals), so it is a plain dual simplex on three planes; three shallow
bounding planes below the cluster keep the anchor of flat clusters, whose optimum is not unique, near the mesh.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from geometry.borrowing import borrowing
from geometry.predicates import orient_sign
from worker.kernels.gilbert import closest_to_origin

RELIABLE, ALWAYS_FRONT, UNRELIABLE = 0, 1, 2
"""Kinds of faces: a unit normal good to NORMAL_ERROR; no area at all (a tie for every eye: always front); neither."""

NORMAL_ERROR = 1e-8  # bound on the error of a reliable unit normal (f8 from f4 positions): slivers beyond it get no cone
ANGLE_MARGIN = 2e-7  # sine by which a cone is first tried narrower; covers float32 rounding of the axis
ANCHOR_MARGIN = 1e-6  # distance an anchor keeps from every plane, times 1 + |anchor|; covers float32 rounding of the anchor
LARGEST_SCALE = 1000.0  # of a scaled normal: coplanar clusters would need infinity
FARTHEST_ANCHOR = 16.0  # normalised units; a cone that starts beyond is of no use
NO_CONE = np.float32(3e38)  # separation of a node without back cone: no eye reaches it

EYE_RADIUS = 100.0
"""Of the sphere U the eyes are spread over, normalised units. Large, as in the paper: with U = 4, where the anchors count, the
closed bunny's walk tests a fifth more edges for eyes between 1.5 and 4 (the anchors of small clusters are predicted too roughly).
"""

_PIVOTS = 40
_BOUND_DEPTH, _BOUND_SLOPE = 8.0, 8.0  # of the bounding planes under the cluster: depth in cluster radii
_VIOLATION = 1e-9


@njit(cache=True)
def face_constraints(positions, faces, normals, offsets, kinds):
    """Unit normals (f, 3) f8, offsets normal . v (f,) f8 and kinds (f,) u1 of all faces, in place."""
    for f in range(faces.shape[0]):
        a, b, c = positions[faces[f, 0]], positions[faces[f, 1]], positions[faces[f, 2]]
        ax, ay, az = np.float64(a[0]), np.float64(a[1]), np.float64(a[2])
        ux, uy, uz = b[0] - ax, b[1] - ay, b[2] - az
        vx, vy, vz = c[0] - ax, c[1] - ay, c[2] - az
        nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
        length = math.sqrt(nx * nx + ny * ny + nz * nz)
        permanent = math.sqrt((ux * ux + uy * uy + uz * uz) * (vx * vx + vy * vy + vz * vz))
        normals[f, :] = 0.0
        offsets[f] = 0.0
        # 16 u |u||v| bounds the error of the cross product generously
        if length > 1e-140 and permanent * 1.8e-15 <= NORMAL_ERROR * length:
            kinds[f] = RELIABLE
            normals[f, 0], normals[f, 1], normals[f, 2] = nx / length, ny / length, nz / length
            offsets[f] = normals[f, 0] * ax + normals[f, 1] * ay + normals[f, 2] * az
        elif (
            orient_sign(a, b, c, 1.0, 0.0, 0.0, 0.0) == 0
            and orient_sign(a, b, c, 0.0, 1.0, 0.0, 0.0) == 0
            and orient_sign(a, b, c, 0.0, 0.0, 1.0, 0.0) == 0
        ):
            kinds[f] = ALWAYS_FRONT
        else:
            kinds[f] = UNRELIABLE


@borrowing
def lowest_point(normals, offsets, sign, index, count, axis, ball, basis, out, scratch):
    """Point least along axis with normal . point >= sign * offset for all index[:count], into out (3,); dual simplex.

    axis (3,) unit, inside the cone of the normals. ball (4,): centre and radius of the cluster; the bounding planes meet
    below it. basis (3,) i4 receives the faces whose planes meet in the point, -1 for a bounding plane. scratch: (6, 4) f8. Ends early
    when a pivot is singular.
    """
    plane, minor = scratch[:3], scratch[3:]
    least = 0 if abs(axis[0]) < 0.57 else 1
    d = axis[least]
    tx, ty, tz = (least == 0) * 1.0 - d * axis[0], (least == 1) * 1.0 - d * axis[1], 0.0 - d * axis[2]
    r = 1.0 / math.sqrt(tx * tx + ty * ty + tz * tz)
    tx, ty, tz = tx * r, ty * r, tz * r
    bx, by, bz = axis[1] * tz - axis[2] * ty, axis[2] * tx - axis[0] * tz, axis[0] * ty - axis[1] * tx
    for k in range(3):
        c, s = math.cos(k * 2.0943951023931953) * _BOUND_SLOPE, math.sin(k * 2.0943951023931953) * _BOUND_SLOPE
        plane[k, 0], plane[k, 1], plane[k, 2] = axis[0] + c * tx + s * bx, axis[1] + c * ty + s * by, axis[2] + c * tz + s * bz
        along = plane[k, 0] * ball[0] + plane[k, 1] * ball[1] + plane[k, 2] * ball[2]
        plane[k, 3] = sign * along - _BOUND_DEPTH * ball[3]
        basis[k] = -1
    x, y, z = 0.0, 0.0, 0.0
    for _ in range(_PIVOTS):
        for k in range(3):
            p, q = (k + 1) % 3, (k + 2) % 3
            minor[k, 0] = plane[p, 1] * plane[q, 2] - plane[p, 2] * plane[q, 1]
            minor[k, 1] = plane[p, 2] * plane[q, 0] - plane[p, 0] * plane[q, 2]
            minor[k, 2] = plane[p, 0] * plane[q, 1] - plane[p, 1] * plane[q, 0]
        det = plane[0, 0] * minor[0, 0] + plane[0, 1] * minor[0, 1] + plane[0, 2] * minor[0, 2]
        if abs(det) < 1e-14:
            break
        x = (plane[0, 3] * minor[0, 0] + plane[1, 3] * minor[1, 0] + plane[2, 3] * minor[2, 0]) / det
        y = (plane[0, 3] * minor[0, 1] + plane[1, 3] * minor[1, 1] + plane[2, 3] * minor[2, 1]) / det
        z = (plane[0, 3] * minor[0, 2] + plane[1, 3] * minor[1, 2] + plane[2, 3] * minor[2, 2]) / det
        worst, entering = _VIOLATION, -1
        for i in range(count):
            f = index[i]
            v = sign * offsets[f] - (normals[f, 0] * x + normals[f, 1] * y + normals[f, 2] * z)
            if v > worst:
                worst, entering = v, f
        if entering < 0:
            break
        leaving, ratio = -1, 1e300
        for k in range(3):
            mu = (minor[k, 0] * normals[entering, 0] + minor[k, 1] * normals[entering, 1] + minor[k, 2] * normals[entering, 2]) / det
            if mu > 1e-12:
                dual = (minor[k, 0] * axis[0] + minor[k, 1] * axis[1] + minor[k, 2] * axis[2]) / det
                if dual / mu < ratio:
                    leaving, ratio = k, dual / mu
        if leaving < 0:
            break
        basis[leaving] = entering
        plane[leaving, 0], plane[leaving, 1], plane[leaving, 2] = normals[entering, 0], normals[entering, 1], normals[entering, 2]
        plane[leaving, 3] = sign * offsets[entering]
    out[0], out[1], out[2] = x, y, z


@borrowing
def _cone_volume(height, lateral, cosine, sine, radius):
    """Volume inside the sphere of the cone with its apex `height` along the axis; a lateral offset shortens its reach.

    The closed form is for an apex on the axis through the centre: cone up to the circle where it meets the sphere, and the
    cap beyond.
    """
    if lateral >= radius:
        return 0.0
    h = height + radius - math.sqrt(radius * radius - lateral * lateral)
    if h >= radius:
        return 0.0
    h = max(h, -0.999 * radius)
    slant = -h * cosine + math.sqrt(radius * radius - h * h * sine * sine)
    z, r = h + slant * cosine, slant * sine
    cap = radius - z
    return math.pi / 3.0 * (r * r * slant * cosine + cap * cap * (2.0 * radius + z))


@borrowing
def miss_probability(axis, spread_cosine, front, back, has_back, radius):
    """P(r): the part of the sphere U of this radius that is in neither cone; spread_cosine: least normal . axis."""
    if spread_cosine <= 0.0:
        return 1.0
    sine = spread_cosine  # the opening is the complement of the spread
    cosine = math.sqrt(max(0.0, 1.0 - sine * sine))
    total = 4.0 / 3.0 * math.pi * radius**3
    h = axis[0] * front[0] + axis[1] * front[1] + axis[2] * front[2]
    n = front[0] * front[0] + front[1] * front[1] + front[2] * front[2]
    covered = _cone_volume(h, math.sqrt(max(0.0, n - h * h)), cosine, sine, radius)
    if has_back:
        h = -(axis[0] * back[0] + axis[1] * back[1] + axis[2] * back[2])
        n = back[0] * back[0] + back[1] * back[1] + back[2] * back[2]
        covered += _cone_volume(h, math.sqrt(max(0.0, n - h * h)), cosine, sine, radius)
    return max(0.0, 1.0 - covered / total)


@borrowing
def fit_cones(normals, offsets, index, count, ball, axis, front, back, support, scratch):
    """Axis (3,) and anchors (3,) of the faces index[:count], in place, unverified; returns the spread's cosine (<= 0: none).

    support (9,) i4 receives the faces that determine them: three of the axis, three a anchor, -1 where fewer.
    scratch: (6, 4) f8.
    """
    support[:] = -1
    if count == 0:
        return -1.0
    x, y, z, least, size = closest_to_origin(normals, index, count, support[0:3])
    support[size:3] = -1
    norm = math.sqrt(x * x + y * y + z * z)
    if norm < 1e-6 or least <= 0.0:
        return -1.0
    axis[0], axis[1], axis[2] = x / norm, y / norm, z / norm
    lowest_point(normals, offsets, 1.0, index, count, axis, ball, support[3:6], front, scratch)
    lowest_point(normals, offsets, -1.0, index, count, axis, ball, support[6:9], back, scratch)
    back[0], back[1], back[2] = -back[0], -back[1], -back[2]
    return min(1.0, least / norm)


@borrowing
def _seat(normals, offsets, sign, index, count, axis, spread, anchor, out):
    """Round an anchor to f4 in out (3,) and raise it along sign * axis until it clears every plane; whether it does."""
    x, y, z = anchor[0], anchor[1], anchor[2]
    for attempt in range(6):
        out[0], out[1], out[2] = x, y, z
        ox, oy, oz = np.float64(out[0]), np.float64(out[1]), np.float64(out[2])
        far = math.sqrt(ox * ox + oy * oy + oz * oz)
        if not far <= FARTHEST_ANCHOR:
            return False
        lack = -1e300
        for i in range(count):
            f = index[i]
            lack = max(lack, sign * (offsets[f] - (normals[f, 0] * ox + normals[f, 1] * oy + normals[f, 2] * oz)))
        lack += 0.25 * ANCHOR_MARGIN * (1.0 + far)
        if lack <= 0.0:
            return True
        step = sign * (lack + ANCHOR_MARGIN * (1.0 + far) * (1.0 + attempt)) / spread
        x, y, z = ox + step * axis[0], oy + step * axis[1], oz + step * axis[2]
    return False


@njit(cache=True)
def verified_cones(normals, offsets, index, count, always_front, axis, spread, front, back, scaled, front_out, back_out):
    """Round cones to f4 so that they hold for all of index[:count]; returns the separation, or -1 when there is no cone.

    scaled, front_out, back_out (3,) f4 receive the node. The exact cones of those float32 values lie strictly inside every
    face's half-space (outside it for the back cone). always_front: the cluster has a face without area, so no eye has all
    of it behind: the separation becomes NO_CONE.
    """
    scale = min(LARGEST_SCALE, 1.0 / (math.sqrt(max(0.0, 1.0 - spread * spread)) + ANGLE_MARGIN))
    narrow = False
    for attempt in range(8):
        scaled[0], scaled[1], scaled[2] = axis[0] * scale, axis[1] * scale, axis[2] * scale
        sx, sy, sz = np.float64(scaled[0]), np.float64(scaled[1]), np.float64(scaled[2])
        square = sx * sx + sy * sy + sz * sz
        if square <= 1.0 + 1e-6:
            return np.float32(-1.0)
        # the dual of {x: s.x >= |x|} holds the normals at sine sqrt(1 - 1/|s|^2) from the plane across s
        limit = math.sqrt(square - 1.0) + 4.0 * NORMAL_ERROR * math.sqrt(square)
        lowest = 1e300
        for i in range(count):
            f = index[i]
            lowest = min(lowest, normals[f, 0] * sx + normals[f, 1] * sy + normals[f, 2] * sz)
        if lowest >= limit:
            narrow = True
            break
        scale *= 1.0 - 1e-6 * 8.0**attempt
    if not narrow or not _seat(normals, offsets, 1.0, index, count, axis, spread, front, front_out):
        return np.float32(-1.0)
    if always_front or not _seat(normals, offsets, -1.0, index, count, axis, spread, back, back_out):
        back_out[:] = front_out
        return NO_CONE
    separation = 0.0
    for k in range(3):
        separation += (np.float64(front_out[k]) - np.float64(back_out[k])) * np.float64(scaled[k])
    return np.float32(separation + 1e-6 * (1.0 + abs(separation)))
