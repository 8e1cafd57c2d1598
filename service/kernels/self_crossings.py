"""Where the faces of a mesh cross or touch each other in space: found once a mesh, whatever the eye.

Two faces that are not in one plane meet in a segment. Its ends are where a side of the one goes through the other, or a corner of the
one lies in the other; all that is decided exactly (`geometry.predicates`), only the places are rounded. Faces that share a side do not
cross. A place is known by a key, so that segments of neighbouring faces are joined: a corner by its vertex, a side that goes through a
face by both.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from geometry.boxes import LEAF, STACK, boxes_meet, next_leaf
from geometry.predicates import orient2d_sign, orient_sign
from service.kernels.line_kinds import corner

SHORTEST = 1e-12
"""Normalised units: two ends nearer than this are the same place, rounded twice."""
HITS = 12
"""More ends than two faces can have."""


@njit(cache=True, nogil=True)
def _inside_in_plane(a, b, c, p):
    """Whether p, exactly in the plane of a triangle, is in the triangle, its border included. False for one without area."""
    for axis in range(3):
        x, y, z = (1.0 if axis == 0 else 0.0), (1.0 if axis == 1 else 0.0), (1.0 if axis == 2 else 0.0)
        turn = orient_sign(a, b, c, x, y, z, 0.0)
        if turn == 0:
            continue
        i, j = (axis + 1) % 3, (axis + 2) % 3
        one = orient2d_sign(a[i], a[j], b[i], b[j], p[i], p[j])
        two = orient2d_sign(b[i], b[j], c[i], c[j], p[i], p[j])
        three = orient2d_sign(c[i], c[j], a[i], a[j], p[i], p[j])
        return min(one * turn, two * turn, three * turn) >= 0
    return False


@njit(cache=True, nogil=True)
def _goes_through(p, q, a, b, c):
    """Whether the segment from p to q, with its ends strictly on two sides of the triangle's plane, meets the triangle."""
    one = orient_sign(p, q, a, b[0], b[1], b[2], 1.0)
    two = orient_sign(p, q, b, c[0], c[1], c[2], 1.0)
    if one * two < 0:
        return False
    three = orient_sign(p, q, c, a[0], a[1], a[2], 1.0)
    return one * three >= 0 and two * three >= 0


@njit(cache=True, inline="always")
def _height(a, b, c, p):
    """A multiple of p's distance from the plane of a triangle."""
    ux, uy, uz, vx, vy, vz = b[0] - a[0], b[1] - a[1], b[2] - a[2], c[0] - a[0], c[1] - a[1], c[2] - a[2]
    return (uy * vz - uz * vy) * (p[0] - a[0]) + (uz * vx - ux * vz) * (p[1] - a[1]) + (ux * vy - uy * vx) * (p[2] - a[2])


@njit(cache=True, inline="always")
def _side(a, b, c, p):
    return orient_sign(a, b, c, p[0], p[1], p[2], 1.0)


@njit(cache=True, nogil=True)
def _shared(positions, faces, f, g, mine):
    """How many corners of f are, by place, corners of g; mine (3,) i8: which of g, or -1."""
    count = 0
    for i in range(3):
        mine[i] = -1
        p = corner(positions, faces[f, i])
        for j in range(3):
            if faces[f, i] == faces[g, j] or p == corner(positions, faces[g, j]):
                mine[i] = j
        count += mine[i] >= 0
    return count


@njit(cache=True, nogil=True)
def _put_hit(hits, keys, count, key, x, y, z):
    if count < HITS:
        hits[count, 0], hits[count, 1], hits[count, 2], keys[count] = x, y, z, key
        return count + 1
    return count


@njit(cache=True, nogil=True)
def _sides_through(positions, faces, f, g, signs, mine, touched, of_half, found, pierced, hits, keys, count):
    """count, and the ends that sides and corners of f have in g, appended to hits (HITS, 3) and keys (HITS,).

    signs (3,): where f's corners are of g's plane. A side that goes through g is a row of pierced (n, 2), its edge and where, and
    found[0] the next one.
    """
    a, b, c = corner(positions, faces[g, 0]), corner(positions, faces[g, 1]), corner(positions, faces[g, 2])
    for k in range(3):
        i, j = faces[f, k], faces[f, (k + 1) % 3]
        p = corner(positions, i)
        if signs[k] == 0 and mine[k] < 0 and _inside_in_plane(a, b, c, p):
            touched[i] = True
            count = _put_hit(hits, keys, count, -1 - np.int64(i), p[0], p[1], p[2])
        if signs[k] * signs[(k + 1) % 3] >= 0:
            continue
        low, high = min(i, j), max(i, j)
        p, q = corner(positions, low), corner(positions, high)
        if not _goes_through(p, q, a, b, c):
            continue
        edge = of_half[3 * f + k]
        from_low, to_high = abs(_height(a, b, c, p)), abs(_height(a, b, c, q))
        t = from_low / (from_low + to_high) if from_low + to_high > 0.0 else 0.5
        x, y, z = p[0] + t * (q[0] - p[0]), p[1] + t * (q[1] - p[1]), p[2] + t * (q[2] - p[2])
        count = _put_hit(hits, keys, count, np.int64(edge) * faces.shape[0] + g, x, y, z)
        if found[0] < pierced.shape[0]:
            pierced[found[0], 0], pierced[found[0], 1] = edge, t
        found[0] += 1
    return count


@njit(cache=True, nogil=True)
def _one_sided(signs, mine):
    """Whether a face meets another's plane at most in the corners that they share."""
    low, high = 2, -2
    for k in range(3):
        if mine[k] < 0:
            low, high = min(low, signs[k]), max(high, signs[k])
    return low > 0 or high < 0


@njit(cache=True, nogil=True)
def _farthest(hits, count):
    """(i, j, square): the two hits that are farthest from each other."""
    first, last, most = 0, 0, 0.0
    for i in range(count):
        for j in range(i):
            square = (hits[i, 0] - hits[j, 0]) ** 2 + (hits[i, 1] - hits[j, 1]) ** 2 + (hits[i, 2] - hits[j, 2]) ** 2
            if square > most:
                first, last, most = j, i, square
    return first, last, most


@njit(cache=True, nogil=True)
def _meet(positions, faces, f, g, touched, of_half, found, pierced, segments, ends, owners, work):
    """Write down where faces f and g meet: found (2,) i8 counts rows of pierced and of segments. work: scratch of `self_crossings`."""
    signs, others, mine, theirs, hits, keys = work
    shared = _shared(positions, faces, f, g, mine)
    if shared > 0:
        _shared(positions, faces, g, f, theirs)
        for k in range(3):  # one place, two vertices
            if mine[k] >= 0 and faces[f, k] != faces[g, mine[k]]:
                touched[faces[f, k]] = True
                touched[faces[g, mine[k]]] = True
        if shared >= 2:
            return
    else:
        theirs[:] = -1
    a, b, c = corner(positions, faces[g, 0]), corner(positions, faces[g, 1]), corner(positions, faces[g, 2])
    for k in range(3):
        signs[k] = 0 if mine[k] >= 0 else _side(a, b, c, corner(positions, faces[f, k]))
    if _one_sided(signs, mine):
        return
    a, b, c = corner(positions, faces[f, 0]), corner(positions, faces[f, 1]), corner(positions, faces[f, 2])
    for k in range(3):
        others[k] = 0 if theirs[k] >= 0 else _side(a, b, c, corner(positions, faces[g, k]))
    if _one_sided(others, theirs):
        return
    flat = signs[0] == 0 and signs[1] == 0 and signs[2] == 0
    count = 0
    if shared == 1:
        for k in range(3):
            if mine[k] >= 0:
                x, y, z = corner(positions, faces[f, k])
                count = _put_hit(hits, keys, count, -1 - np.int64(faces[f, k]), x, y, z)
    count = _sides_through(positions, faces, f, g, signs, mine, touched, of_half, found, pierced, hits, keys, count)
    count = _sides_through(positions, faces, g, f, others, theirs, touched, of_half, found, pierced, hits, keys, count)
    i, j, square = _farthest(hits, count)
    if flat or square <= SHORTEST * SHORTEST:
        return
    n = found[1]
    if n < owners.shape[0]:
        segments[n, 0], segments[n, 1], owners[n, 0], owners[n, 1] = keys[i], keys[j], f, g
        for k in range(3):
            ends[n, k], ends[n, 3 + k] = hits[i, k], hits[j, k]
    found[1] += 1


@njit(cache=True, nogil=True)
def _face_boxes(positions, faces):
    boxes = np.empty((faces.shape[0], 6), np.float32)
    for f in range(faces.shape[0]):
        for k in range(3):
            x, y, z = positions[faces[f, 0], k], positions[faces[f, 1], k], positions[faces[f, 2], k]
            boxes[f, k], boxes[f, 3 + k] = min(x, y, z), max(x, y, z)
    return boxes


@njit(cache=True, nogil=True)
def self_crossings(positions, faces, order, boxes, of_half, most):
    """(found (2,) i8, touched (v,) bool, pierced (n, 2) f8, keys (m, 2) i8, ends (m, 6) f8, owners (m, 2) i4).

    order, boxes: `geometry.boxes.build_boxes`; of_half: `geometry.edge_fans`. pierced: an edge that goes through a face and where, from
    its lower vertex on, each once or twice. keys, ends, owners: the segments in which faces meet, the keys and places of their ends, the
    two faces. touched: vertices that lie in a face, or at the place of a vertex, that is not theirs. found: how many rows there would be
    of pierced and of segments; where either is more than `most` (pierced: twice that), the search has ended early.
    """
    leaves, count = boxes.shape[0] // 2, faces.shape[0]
    found, touched = np.zeros(2, np.int64), np.zeros(positions.shape[0], np.bool_)
    pierced, keys = np.empty((2 * most, 2)), np.empty((most, 2), np.int64)
    ends, owners = np.empty((most, 6)), np.empty((most, 2), np.int32)
    each, stack = _face_boxes(positions, faces), np.empty(STACK, np.int64)
    work = (
        np.empty(3, np.int64),
        np.empty(3, np.int64),
        np.empty(3, np.int64),
        np.empty(3, np.int64),
        np.empty((HITS, 3)),
        np.empty(HITS, np.int64),
    )
    for own in range(leaves):
        start = own * LEAF
        if start >= count or found[0] > 2 * most or found[1] > most:
            break
        stack[0], top = 1, 1
        while True:
            leaf, top = next_leaf(boxes, boxes[leaves + own], stack, top)
            if leaf < 0:
                break
            other = leaf * LEAF
            if other < start:
                continue
            for i in range(start, min(start + LEAF, count)):
                for j in range(max(other, i + 1), min(other + LEAF, count)):
                    if boxes_meet(each[order[i]], each[order[j]]):
                        _meet(positions, faces, order[i], order[j], touched, of_half, found, pierced, keys, ends, owners, work)
    return found, touched, pierced[: found[0]].copy(), keys[: found[1]].copy(), ends[: found[1]].copy(), owners[: found[1]].copy()


@njit(cache=True, nogil=True)
def segments_through(positions, faces, order, boxes, ends, owners, most):
    """(found, of (n,) i4, at (n,) f8): where segments go through faces that are not theirs, and parts of them from their first ends.

    ends (m, 6) f8, owners (m, 2) i4: `self_crossings`. Exact for the ends as they are rounded. found: how many there would be; where that
    is more than `most`, the search has ended early.
    """
    found = 0
    of, at = np.empty(most, np.int32), np.empty(most)
    stack, about = np.empty(STACK, np.int64), np.empty(6)
    for m in range(ends.shape[0]):
        if found > most:
            break
        p, q = (ends[m, 0], ends[m, 1], ends[m, 2]), (ends[m, 3], ends[m, 4], ends[m, 5])
        for k in range(3):
            about[k], about[3 + k] = min(p[k], q[k]), max(p[k], q[k])
        stack[0], top = 1, 1
        while True:
            leaf, top = next_leaf(boxes, about, stack, top)
            if leaf < 0:
                break
            start = leaf * LEAF
            for i in range(start, min(start + LEAF, faces.shape[0])):
                f = order[i]
                if f == owners[m, 0] or f == owners[m, 1]:
                    continue
                a, b, c = corner(positions, faces[f, 0]), corner(positions, faces[f, 1]), corner(positions, faces[f, 2])
                if _side(a, b, c, p) * _side(a, b, c, q) >= 0 or not _goes_through(p, q, a, b, c):
                    continue
                if found < most:
                    from_p, to_q = abs(_height(a, b, c, p)), abs(_height(a, b, c, q))
                    of[found], at[found] = m, (from_p / (from_p + to_q) if from_p + to_q > 0.0 else 0.5)
                found += 1
    found_all = min(found, most)
    return found, of[:found_all].copy(), at[:found_all].copy()
