"""Lines as filled shapes in the image: capsules along edges, and what a fattened face has beyond them.

GL's lines have no width to speak of, so each is a fan of triangles made here, in float64. (One instance an edge, with the shape made by
the vertex shader, took 7 to 20 times as long on a software renderer, which runs its vertex stage anew for every instance.)

Vertices are x and y in image pixels and depth, 1 at the eye and falling away from it. A fan of n corners has n - 2 triangles:

    capsule          _______________            fattened edge     ____ outwards ____
                   (  a ---------- b  )                          /                  \\
                    '-----------------'                         a ------------------ b
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit

INNER_PX = 0.5
"""A fattened edge begins so far inside its face, so that no sample is missed between it and the surface."""
MARGIN_PX = 2.0
MOST_ROUND = 0.5 * math.pi
ROUND_FALL, SHARP_FALL = 1.0, 40.0
"""Pixels' sizes that a fattened edge's corner falls away by on each pixel beyond its end: of a turn up to MOST_ROUND, of a sharper one."""
LARGEST_GAIN, LARGEST_RISE_PX = 3.0, 6.0
"""Most pixels' sizes by which a fattened face comes nearer on each pixel that it grows, that of one whose normal is 70 degrees off V; and
across its whole width: a steep wide one would come before all else."""


class StrokeView(NamedTuple):
    """Where strokes are. matrix: (4, 4) f8 homogeneous pixels u, v, depth and w. eye: (4,) f8. nearest: least w that is drawn.

    x0, y0, x1, y1: rectangle of the image that is drawn, pixels. share, shift: depth d seen one pixel's size nearer is
    d (1 + share) + shift. flip: -1 in a mirrored view, else 1.
    """

    matrix: np.ndarray
    eye: np.ndarray
    nearest: float
    x0: float
    y0: float
    x1: float
    y1: float
    share: float
    shift: float
    flip: float


class Pen(NamedTuple):
    """How strokes look. radius: pixels, half the width, or all of it beyond a fattened edge. reference: w at which it is that, 0 for
    everywhere. near_share, near_shift, near_by: what brings it nearer: depth d at w is d (1 + near_share) w / (w - near_by) + near_shift.
    steps: pieces of a quarter of a round end. least_gain: of a fattened face, against LARGEST_GAIN. most_rise: capsules come nearer by what
    the face beside them rises over their radius, at most so much a pixel; 0 for not at all.
    """

    radius: float
    reference: float
    near_share: float
    near_shift: float
    near_by: float
    steps: int
    least_gain: float
    most_rise: float


@njit(cache=True, nogil=True)
def corners_of(fattened, steps):
    """Corners of a fan."""
    return 2 * steps + 4 if fattened else 4 * steps + 2


@njit(cache=True, nogil=True)
def make_strokes(view, pen, positions, ends, turns, vertices, indices):
    """Fans for ends (n, 4) i4 (`line_faces.layer_edges`; of capsules only the first two columns count) into vertices (n corners, 3) f4
    and indices (n 3 (corners - 2)) i4. turns (n, 2) f8 (`stroke_turns.turns_at_ends`) of fattened edges; (0, 2) for capsules.
    Returns how many strokes there are: those outside the picture are none.
    """
    fattened = turns.shape[0] > 0
    corners, steps = corners_of(fattened, pen.steps), pen.steps
    turn = 0.5 * math.pi / steps
    cosines, sines = np.empty(steps + 1), np.empty(steps + 1)
    for k in range(steps + 1):
        cosines[k], sines[k] = math.cos(k * turn), math.sin(k * turn)
    most_gain = min(LARGEST_GAIN, LARGEST_RISE_PX / pen.radius)
    segment = np.empty(8)
    count = 0
    for i in range(ends.shape[0]):
        a, b = ends[i, 0], ends[i, 1]
        if not _place(view, pen, positions, a, b, segment):
            continue
        base = count * corners
        if fattened:
            gain = min(max(_gain(view, positions, a, b, ends[i, 2]), pen.least_gain), most_gain)
            _fatten(view, segment, gain, view.flip * ends[i, 3], turns[i], steps, vertices[base : base + corners])
        else:
            if pen.most_rise > 0.0 and ends.shape[1] == 4:
                rise = min(max(-_gain(view, positions, a, b, ends[i, 2]), 0.0), pen.most_rise)
                segment[2] = _gained(view, segment[2], rise * segment[3])
                segment[6] = _gained(view, segment[6], rise * segment[7])
            _capsule(segment, cosines, sines, vertices[base : base + corners])
        _join(fattened, steps, corners, base, indices[3 * count * (corners - 2) :])
        count += 1
    return count


@njit(cache=True, nogil=True)
def _join(fattened, steps, corners, base, indices):
    """Triangles of a stroke whose corners begin at base: a fan about its first one, but of a fattened edge's other end about its last."""
    for k in range(corners - 2):
        apex, second, third = 0, k + 1, k + 2
        if fattened and k == corners - 3:
            second, third = steps + 2, corners - 1
        elif fattened and k > steps:
            apex = corners - 1
        indices[3 * k], indices[3 * k + 1], indices[3 * k + 2] = base + apex, base + second, base + third


@njit(cache=True, nogil=True)
def _row(matrix, r, x, y, z):
    return matrix[r, 0] * x + matrix[r, 1] * y + matrix[r, 2] * z + matrix[r, 3]


@njit(cache=True, nogil=True)
def _place(view, pen, positions, a, b, out):
    """out (8,) f8: x, y, depth and radius of both ends of the part of an edge that is before the eye and near the picture."""
    m = view.matrix
    ax, ay, az = np.float64(positions[a, 0]), np.float64(positions[a, 1]), np.float64(positions[a, 2])
    bx, by, bz = np.float64(positions[b, 0]), np.float64(positions[b, 1]), np.float64(positions[b, 2])
    wa, wb = _row(m, 3, ax, ay, az), _row(m, 3, bx, by, bz)
    if wa < view.nearest and wb < view.nearest:
        return False
    ua, va, da = _row(m, 0, ax, ay, az), _row(m, 1, ax, ay, az), _row(m, 2, ax, ay, az)
    ub, vb, db = _row(m, 0, bx, by, bz), _row(m, 1, bx, by, bz), _row(m, 2, bx, by, bz)
    if wa < view.nearest:
        t = (view.nearest - wa) / (wb - wa)
        ua, va, da, wa = ua + t * (ub - ua), va + t * (vb - va), da + t * (db - da), view.nearest
    elif wb < view.nearest:
        t = (view.nearest - wb) / (wa - wb)
        ub, vb, db, wb = ub + t * (ua - ub), vb + t * (va - vb), db + t * (da - db), view.nearest
    xa, ya, xb, yb = ua / wa, va / wa, ub / wb, vb / wb
    ra = rb = pen.radius
    if pen.reference > 0.0:
        ra, rb = pen.radius * pen.reference / wa, pen.radius * pen.reference / wb
    da, db = _nearer(pen, da / wa, wa), _nearer(pen, db / wb, wb)
    reach = max(ra, rb) + MARGIN_PX
    t0, t1 = _within(xa, xb - xa, view.x0 - reach, view.x1 + reach, 0.0, 1.0)
    t0, t1 = _within(ya, yb - ya, view.y0 - reach, view.y1 + reach, t0, t1)
    if t0 > t1:
        return False
    out[0], out[1], out[2], out[3] = xa + t0 * (xb - xa), ya + t0 * (yb - ya), da + t0 * (db - da), ra + t0 * (rb - ra)
    out[4], out[5], out[6], out[7] = xa + t1 * (xb - xa), ya + t1 * (yb - ya), da + t1 * (db - da), ra + t1 * (rb - ra)
    return True


@njit(cache=True, nogil=True)
def _within(start, change, low, high, t0, t1):
    """The part of t0 ... t1 in which start + t change is between low and high."""
    if change == 0.0:
        return (t0, t1) if low <= start <= high else (1.0, 0.0)
    first, last = (low - start) / change, (high - start) / change
    return max(t0, min(first, last)), min(t1, max(first, last))


@njit(cache=True, nogil=True)
def _nearer(pen, depth, w):
    scale = 1.0 if pen.near_by <= 0.0 else w / max(w - pen.near_by, 0.05 * w)
    return depth * (1.0 + pen.near_share) * scale + pen.near_shift


@njit(cache=True, nogil=True)
def _along(segment):
    """Unit direction of a segment in the image; any for a point."""
    tx, ty = segment[4] - segment[0], segment[5] - segment[1]
    length = math.sqrt(tx * tx + ty * ty)
    return (tx / length, ty / length) if length > 1e-9 else (1.0, 0.0)


@njit(cache=True, nogil=True)
def _put(vertices, k, x, y, depth):
    vertices[k, 0], vertices[k, 1], vertices[k, 2] = x, y, depth


@njit(cache=True, nogil=True)
def _capsule(segment, cosines, sines, vertices):
    """Round about both ends."""
    tx, ty = _along(segment)
    steps = cosines.shape[0] - 1
    k = 0
    for end in range(2):
        x, y, depth, r = segment[4 - 4 * end], segment[5 - 4 * end], segment[6 - 4 * end], segment[7 - 4 * end]
        for i in range(2 * steps + 1):
            # from one side over the end to the other
            across = -cosines[i] if i <= steps else cosines[2 * steps - i]
            beyond = sines[i] if i <= steps else sines[2 * steps - i]
            if end == 1:
                across, beyond = -across, -beyond
            _put(vertices, k, x + r * (beyond * tx - across * ty), y + r * (beyond * ty + across * tx), depth)
            k += 1


@njit(cache=True, nogil=True)
def _gain(view, positions, a, b, c):
    """Pixels by which the plane of a face comes nearer on each pixel outwards over its edge a b, perpendicular to that in the image.

    A step s = sin(alpha) / (V . N) along E x N is one pixel there (section 3.3); -V . (E x N) of it is towards the eye.
    """
    ax, ay, az = np.float64(positions[a, 0]), np.float64(positions[a, 1]), np.float64(positions[a, 2])
    ex, ey, ez = positions[b, 0] - ax, positions[b, 1] - ay, positions[b, 2] - az
    cx, cy, cz = positions[c, 0] - ax, positions[c, 1] - ay, positions[c, 2] - az
    w = view.eye[3]
    vx = w * (ax + 0.5 * ex) - view.eye[0]
    vy = w * (ay + 0.5 * ey) - view.eye[1]
    vz = w * (az + 0.5 * ez) - view.eye[2]
    far, long = math.sqrt(vx * vx + vy * vy + vz * vz), math.sqrt(ex * ex + ey * ey + ez * ez)
    if far == 0.0 or long == 0.0:
        return 0.0
    vx, vy, vz, ex, ey, ez = vx / far, vy / far, vz / far, ex / long, ey / long, ez / long
    along = cx * ex + cy * ey + cz * ez
    ox, oy, oz = along * ex - cx, along * ey - cy, along * ez - cz  # from the third corner to the edge, in the face
    size = math.sqrt(ox * ox + oy * oy + oz * oz)
    if size == 0.0:
        return 0.0
    cosine = vx * ex + vy * ey + vz * ez
    outwards = (vx * ox + vy * oy + vz * oz) / size
    facing = math.sqrt(max(1.0 - cosine * cosine - outwards * outwards, 0.0))
    return -outwards * math.sqrt(max(1.0 - cosine * cosine, 0.0)) / max(facing, 1e-6)


@njit(cache=True, nogil=True)
def _fatten(view, segment, gain, facing, turns, steps, vertices):
    """What a face has beyond one of its edges once it is fatter, in its plane; rounded at its ends as far as the outline turns outwards.

    Of an end where that is not known a quarter of a circle falls away from the eye, so that the surface hides what is over it; so does one
    of a sharp turn, which a fold of the surface before itself has.
    """
    tx, ty = _along(segment)
    # counter-clockwise as seen: the face is on the left, which is up and to the right where y runs down
    nx, ny = -facing * ty, facing * tx
    k = 0
    for end in range(2):
        x, y, depth, r = segment[4 - 4 * end], segment[5 - 4 * end], segment[6 - 4 * end], segment[7 - 4 * end]
        turn = turns[1 - end]
        fall = ROUND_FALL if turn <= MOST_ROUND else SHARP_FALL
        angle = min(turn, MOST_ROUND) / steps
        if angle <= 0.0:
            cosine, sine, out, beyond = 1.0, 0.0, 1.0, 0.0
        elif end == 0:  # to the outward direction
            cosine, sine = math.cos(angle), -math.sin(angle)
            out, beyond = math.cos(angle * steps), math.sin(angle * steps)
        else:  # from there
            cosine, sine, out, beyond = math.cos(angle), math.sin(angle), 1.0, 0.0
        if end == 0:
            _put(vertices, k, x - INNER_PX * nx, y - INNER_PX * ny, _gained(view, depth, -INNER_PX * gain))
            k += 1
        for _ in range(steps + 1):
            aside = beyond if end == 0 else -beyond
            at_x, at_y = x + r * (out * nx + aside * tx), y + r * (out * ny + aside * ty)
            _put(vertices, k, at_x, at_y, _gained(view, depth, r * (out * gain - fall * beyond)))
            k += 1
            out, beyond = out * cosine - beyond * sine, beyond * cosine + out * sine
        if end == 1:
            _put(vertices, k, x - INNER_PX * nx, y - INNER_PX * ny, _gained(view, depth, -INNER_PX * gain))


@njit(cache=True, nogil=True)
def _gained(view, depth, pixels):
    return depth * max(1.0 + view.share * pixels, 0.05) + view.shift * pixels
