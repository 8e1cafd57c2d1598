"""Which pieces of lines are in sight: by rays to the eye, as few as can be.

The pieces that start at a vertex of the mesh are in sight or not together, but for those that a face about that vertex hides, which is
decided exactly without a ray. So pieces are joined at vertices, and of each set that hangs together three are looked at. A face hides a
point when it has the point and the eye strictly on two sides, and the ray goes through it or its border; so the faces that a line lies
on do not hide it, however it is rounded. All sides are exact (`geometry.predicates`).
"""

from __future__ import annotations

import numpy as np
from numba import njit

from geometry.boxes import LEAF, STACK
from geometry.predicates import orient_sign
from geometry.union_find import find_root
from service.kernels.line_image import along
from service.kernels.line_kinds import corner
from service.kernels.line_pieces import END, START, hidden_at

LOOKS = 3
"""Rays to a set of so many pieces or more; most of them decide."""
FAR = 1e300
ROUNDED = 1e-12
"""Normalised units by which the ends of an intersection may be off: more than rounding takes, but of needles."""
WIDER = 1e-12
"""Normalised units by which boxes are widened: more than rounding moves a ray, so that it cannot miss a box for that."""


@njit(cache=True, inline="always")
def _slab(low, high, at, step, near, far):
    """The part of a ray that is between two planes, and in near to far already."""
    if step == 0.0:
        return (near, far) if low - WIDER <= at <= high + WIDER else (1.0, 0.0)
    one, two = (low - WIDER - at) / step, (high + WIDER - at) / step
    return max(near, min(one, two)), min(far, max(one, two))


@njit(cache=True, nogil=True)
def _meets(box, px, py, pz, dx, dy, dz, far):
    """Whether the ray from p along d, up to `far` times d, meets a box (6,); when in doubt, yes."""
    near, end = _slab(np.float64(box[0]), np.float64(box[3]), px, dx, 0.0, far)
    if near > end or box[0] > box[3]:  # one of no triangles is inverted
        return False
    near, end = _slab(np.float64(box[1]), np.float64(box[4]), py, dy, near, end)
    if near > end:
        return False
    near, end = _slab(np.float64(box[2]), np.float64(box[5]), pz, dz, near, end)
    return near <= end


@njit(cache=True, inline="always")
def _normal(a, b, c):
    ux, uy, uz, vx, vy, vz = b[0] - a[0], b[1] - a[1], b[2] - a[2], c[0] - a[0], c[1] - a[1], c[2] - a[2]
    return uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx


@njit(cache=True, nogil=True)
def _point_side(a, b, c, ends, p):
    """The side of a plane on which p is, a rounded point of the segment between ends: exact where both ends are on one side or on it.

    Where the ends are rounded too, what is nearer than ROUNDED counts as on it: of more than two faces that meet in one line any is.
    """
    if ends[6] == 0.0:
        nx, ny, nz = _normal(a, b, c)
        height = nx * (p[0] - a[0]) + ny * (p[1] - a[1]) + nz * (p[2] - a[2])
        if abs(height) <= ROUNDED * np.sqrt(nx * nx + ny * ny + nz * nz):
            return 0
    else:
        one = orient_sign(a, b, c, ends[0], ends[1], ends[2], 1.0)
        two = orient_sign(a, b, c, ends[3], ends[4], ends[5], 1.0)
        if one * two >= 0:
            return one if one != 0 else two
    return orient_sign(a, b, c, p[0], p[1], p[2], 1.0)


@njit(cache=True, nogil=True)
def _hides(a, b, c, side, ends, p, eye):
    """Whether a triangle with the eye on this side, not 0, hides p."""
    x, y, z, w = eye[0], eye[1], eye[2], eye[3]
    one = orient_sign(p, a, b, x, y, z, w)
    two = orient_sign(p, b, c, x, y, z, w)
    if one * two < 0:
        return False
    three = orient_sign(p, c, a, x, y, z, w)
    if one * three < 0 or two * three < 0:
        return False
    return _point_side(a, b, c, ends, p) * side < 0


@njit(cache=True, nogil=True)
def is_hidden(positions, faces, order, boxes, sides, eye, p, ends, v, w, owners, stack):
    """Whether a face is between p, three f8, and the eye (4,) f8.

    sides: `line_kinds.eye_sides`; order, boxes: `geometry.boxes.build_boxes`. ends (7,) f8: both ends of the segment that p is on, and
    whether these are exact; v, w: the vertices that they are, if any: a face that has both is not even asked, since exact arithmetic would
    be. owners (2,): faces that do not count, -1 for none. stack (STACK,) i8: scratch.
    """
    leaves, far = boxes.shape[0] // 2, (1.0 if eye[3] != 0.0 else FAR)
    dx, dy, dz = eye[0] - eye[3] * p[0], eye[1] - eye[3] * p[1], eye[2] - eye[3] * p[2]
    stack[0], top = 1, 1
    while top > 0:
        top -= 1
        node = stack[top]
        if not _meets(boxes[node], p[0], p[1], p[2], dx, dy, dz, far):
            continue
        if node < leaves:
            stack[top], stack[top + 1] = 2 * node, 2 * node + 1
            top += 2
            continue
        start = (node - leaves) * LEAF
        for n in range(start, min(start + LEAF, faces.shape[0])):
            f = order[n]
            i, j, k = faces[f, 0], faces[f, 1], faces[f, 2]
            has_both = v in (i, j, k) and w in (i, j, k)
            if sides[f] == 0 or has_both or f == owners[0] or f == owners[1]:
                continue
            a, b, c = corner(positions, i), corner(positions, j), corner(positions, k)
            if _hides(a, b, c, np.int64(sides[f]), ends, p, eye):
                return True
    return False


@njit(cache=True, nogil=True)
def _join(surface, sides, eye, rings, touched, line, free, nodes, parent, hidden):
    """Join pieces in parent (p,) that are in sight together; mark in hidden (p,) bool those that a face about their vertex hides."""
    positions, faces = surface
    ring_starts, ring = rings
    first = np.full(positions.shape[0], -1, np.int32)
    for i in range(line.shape[0]):
        for end in range(2):
            v, w = nodes[line[i], end], nodes[line[i], 1 - end]
            # of an intersection neither end is a vertex whose faces are all that is about it
            if not free[i] & (END if end else START) or v >= positions.shape[0] or w >= positions.shape[0] or touched[v]:
                continue
            if hidden_at(positions, faces, sides, eye, ring_starts, ring, v, w):
                hidden[i] = True
            elif first[v] < 0:
                first[v] = i
            else:
                parent[find_root(parent, i)] = find_root(parent, first[v])


@njit(cache=True, nogil=True)
def _look(surface, tree, sides, eye, lines, nodes, ends, owners, line, spans, i, scratch):
    """Whether the middle of piece i is hidden."""
    positions, faces = surface
    order, boxes = tree
    segment, stack = scratch
    n = line[i]
    t = along(lines, n, 0.5 * (spans[i, 0] + spans[i, 1]))
    for k in range(6):
        segment[k] = ends[n, k]
    segment[6] = 1.0 if owners[n, 0] < 0 else 0.0
    x, y, z = ends[n, 0], ends[n, 1], ends[n, 2]
    p = (x + t * (ends[n, 3] - x), y + t * (ends[n, 4] - y), z + t * (ends[n, 5] - z))
    return is_hidden(positions, faces, order, boxes, sides, eye, p, segment, nodes[n, 0], nodes[n, 1], (owners[n, 0], owners[n, 1]), stack)


@njit(cache=True, nogil=True)
def _members(parent):
    """(starts, members): pieces by their sets' roots; members[starts[r]:starts[r + 1]] are those of root r, ascending."""
    count = parent.shape[0]
    starts = np.zeros(count + 1, np.int64)
    for i in range(count):
        parent[i] = find_root(parent, i)
        starts[parent[i] + 1] += 1
    starts = np.cumsum(starts)
    place, members = starts[:-1].copy(), np.empty(count, np.int32)
    for i in range(count):
        members[place[parent[i]]] = i
        place[parent[i]] += 1
    return starts, members


@njit(cache=True, nogil=True)
def pieces_in_sight(surface, tree, sides, eye, rings, touched, lines, nodes, ends, owners, line, spans, free):
    """((p,) bool, rays): which pieces are in sight, and how many rays that took.

    surface: positions (v, 3) f4, faces (f, 3) i4; tree: order, boxes of `geometry.boxes.build_boxes`; sides: `line_kinds.eye_sides`;
    eye (4,) f8; rings: `geometry.edge_fans.faces_about_vertices`; touched (v,) bool: `self_crossings`. lines (n, COLUMNS) f8:
    `line_image`; nodes (n, 2) i4: the vertices that they end in, v and more for other places; ends (n, 6) f8: in space; owners (n, 2) i4:
    the faces that an intersection is in, -1 for an edge. line, spans, free: `line_pieces.cut_lines`.
    """
    count = line.shape[0]
    parent, hidden, rays = np.arange(count, dtype=np.int32), np.zeros(count, np.bool_), 0
    _join(surface, sides, eye, rings, touched, line, free, nodes, parent, hidden)
    scratch = (np.empty(7), np.empty(STACK, np.int64))
    starts, members = _members(parent)
    for root in range(count):
        size = starts[root + 1] - starts[root]
        if size == 0:
            continue
        known = False
        for k in range(starts[root], starts[root + 1]):
            known |= hidden[members[k]]
        if not known:
            looks, seen = (LOOKS if size >= LOOKS else 1), 0
            for k in range(looks):
                i = members[starts[root] + (k * (size - 1)) // max(looks - 1, 1)]
                seen += not _look(surface, tree, sides, eye, lines, nodes, ends, owners, line, spans, i, scratch)
                rays += 1
                if 2 * seen > looks or 2 * (k + 1 - seen) >= looks:
                    break
            known = 2 * seen <= looks
        if known:
            for k in range(starts[root], starts[root + 1]):
                hidden[members[k]] = True
    return ~hidden, rays
