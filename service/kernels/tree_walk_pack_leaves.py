"""Packs the edges of a forest's nodes into leaves for the walk.

A *leaf* is a run of whole cache lines: a head, the planes of up to 64 faces, the numbers of both faces of up to 64 edges, the
numbers of their ends, and a table of the vertices they are. Planes are differences of 16 bits from one plane of the leaf;
how far they are off at most is measured, and stands in the head.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from service.kernels.tree_walk import (
    CORNERS,
    COUNTS,
    EDGES_BITS,
    FIRST_SHARE,
    FLIPPED,
    FORCED,
    HEAD_WORDS,
    LINE,
    MORE_BIT,
    PLANE,
    PLANE_ERROR,
    PLANE_WORDS,
    STEP,
    TURN_BITS,
    VERTICES_BITS,
)
from service.kernels.tree_walk_lanes import LANES
from service.kernels.tree_walk_leaf import ALL
from service.kernels.tree_walk_pack import EDGES_ONLY

LARGEST = 32767.0  # of a 16-bit number
NORMAL_ERROR = 1e-9
"""Of a component of a unit normal. Where another component is made 1 and none is then larger than m, it is at most
NORMAL_ERROR (1 + m) sqrt(3) m, and of the distance sqrt(2) times that and the largest |position|."""
STEEPEST = 2.0**-7
"""Faces with a normal of which the component to be made 1 is smaller are decided exactly: they would make the leaf's steps coarse."""
_ROUNDED_UP = 1.0 + 2.0**-18  # covers the rounding of the errors and of the bound made of them
COLUMNS = 6
"""Columns of a leaf's record: first edge in the order, edges, faces, vertices, whether the next leaf is of the same node, line."""
START, EDGES, FACES, VERTICES, MORE, AT = range(COLUMNS)


@njit(cache=True)
def _count_new(values, mark, leaf):
    """How many of two values are not marked with the leaf."""
    return (1 if mark[values[0]] != leaf else 0) + (1 if mark[values[1]] != leaf else 0)


@njit(cache=True)
def _new(values, mark, leaf):
    """How many of two values are not marked with the leaf; marks them."""
    new = 0
    for k in range(2):
        if mark[values[k]] != leaf:
            mark[values[k]] = leaf
            new += 1
    return new


@njit(cache=True)
def leaf_words(faces, edges, vertices):
    """Words of a leaf, whole cache lines."""
    words = HEAD_WORDS + 12 * ((faces + 7) // 8) + 16 * ((edges + 15) // 16) + vertices
    return (words + LINE - 1) // LINE * LINE


@njit(cache=True)
def _parts_from(planes, pair, least):
    """Whether the faces of a leaf have a large component of their normals in common, but none with two faces more.

    least (3,) f8: of each component the smallest absolute value in the leaf. Faces without a plane do not count.
    """
    shared, shared_with = 0.0, 0.0
    for k in range(3):
        shared, shared_with = max(shared, least[k]), max(shared_with, _less_steep(planes, pair, k, least[k]))
    return shared >= STEEPEST > shared_with


@njit(cache=True)
def _less_steep(planes, pair, k, least):
    """The smallest absolute value of component k of the normals of a leaf, which was `least` before the pair of faces came."""
    for face in pair:
        p = planes[face]
        if p[0] != 0.0 or p[1] != 0.0 or p[2] != 0.0:
            least = min(least, abs(p[k]))
    return least


@njit(cache=True)
def split_leaves(item, edge_start, edge_index, edge_faces, edge_vertices, planes, face_mark, vertex_mark, first_leaf, order, record):
    """Share the edges of every item out to leaves of at most 64 faces, edges and vertices; returns (their number, lines, faces in all).

    planes (f, 4) f8 of `unit_planes`: a leaf ends where its faces would lose the last large component that their normals share.
    first_leaf (b, LANES) i4 receives leaf numbers, -1 where an item has no edges; order (e,) i4 the edges by leaf; record
    (e, COLUMNS) i4. The marks (f,) and (v,) i4 are scratch, -1 at first.
    """
    leaf, at, line, in_all = -1, 0, 0, 0
    least = np.ones(3)
    for b in range(item.shape[0]):
        for j in range(LANES):
            first_leaf[b, j] = -1
            node = item[b, j] & ~EDGES_ONLY
            if item[b, j] < 0 or edge_start[node] == edge_start[node + 1]:
                continue
            first_leaf[b, j] = leaf + 1
            full = True
            for k in range(edge_start[node], edge_start[node + 1]):
                e = edge_index[k]
                if not full:
                    faces, vertices = _count_new(edge_faces[e], face_mark, leaf), _count_new(edge_vertices[e], vertex_mark, leaf)
                    full = record[leaf, EDGES] == ALL or record[leaf, FACES] + faces > ALL or record[leaf, VERTICES] + vertices > ALL
                    if full or _parts_from(planes, edge_faces[e], least):
                        full = True
                        record[leaf, MORE] = 1
                        line += leaf_words(record[leaf, FACES], record[leaf, EDGES], record[leaf, VERTICES]) // LINE
                        in_all += record[leaf, FACES]
                if full:
                    leaf += 1
                    record[leaf, START], record[leaf, AT] = at, line
                    record[leaf, EDGES], record[leaf, FACES], record[leaf, VERTICES], record[leaf, MORE] = 0, 0, 0, 0
                    least[:] = 1.0
                    full = False
                for axis in range(3):
                    least[axis] = _less_steep(planes, edge_faces[e], axis, least[axis])
                record[leaf, EDGES] += 1
                record[leaf, FACES] += _new(edge_faces[e], face_mark, leaf)
                record[leaf, VERTICES] += _new(edge_vertices[e], vertex_mark, leaf)
                order[at] = e
                at += 1
            line += leaf_words(record[leaf, FACES], record[leaf, EDGES], record[leaf, VERTICES]) // LINE
            in_all += record[leaf, FACES]
    return leaf + 1, line, in_all


@njit(cache=True)
def unit_planes(positions, faces):
    """(f, 4) f8: unit normal and -normal . v of every face, all zero where the normal is not known to NORMAL_ERROR."""
    planes = np.zeros((faces.shape[0], 4))
    for f in range(faces.shape[0]):
        a, b, c = positions[faces[f, 0]], positions[faces[f, 1]], positions[faces[f, 2]]
        ax, ay, az = np.float64(a[0]), np.float64(a[1]), np.float64(a[2])
        ux, uy, uz, vx, vy, vz = b[0] - ax, b[1] - ay, b[2] - az, c[0] - ax, c[1] - ay, c[2] - az
        x, y, z = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
        length = math.sqrt(x * x + y * y + z * z)
        # 16 u |u||v| bounds the error of the cross product generously
        permanent = 1.8e-15 * math.sqrt((ux * ux + uy * uy + uz * uz) * (vx * vx + vy * vy + vz * vz))
        if length > 1e-140 and permanent <= NORMAL_ERROR * length:
            x, y, z = x / length, y / length, z / length
            planes[f, 0], planes[f, 1], planes[f, 2], planes[f, 3] = x, y, z, -(x * ax + y * ay + z * az)
    return planes


@njit(cache=True)
def _turn_of(planes, own, count):
    """Which component of the normals of own[:count] is farthest from zero where it is nearest to it."""
    best, turn = -1.0, 0
    for k in range(3):
        least = 1.0
        for i in range(count):
            p = planes[own[i]]
            if p[0] != 0.0 or p[1] != 0.0 or p[2] != 0.0:
                least = min(least, abs(p[k]))
        if least > best:
            best, turn = least, k
    return turn


@njit(cache=True)
def _bits_of(planes, own, count, turn):
    """(faces without a plane, or with one that cannot be divided by its component `turn`; faces whose component is negative)."""
    forced, flipped = np.uint64(0), np.uint64(0)
    for i in range(count):
        bit = np.uint64(1) << np.uint64(i)
        if abs(planes[own[i], turn]) < STEEPEST:
            forced |= bit
        elif planes[own[i], turn] < 0.0:
            flipped |= bit
    return forced, flipped


@njit(cache=True)
def _put_planes(planes, own, count, forced, turn, reach, scale, arena, at):
    """The planes that are not forced, times scale f4, into the leaf at word `at`; returns by how much they are off at most.

    That bounds the error of a height, roundings of the test included, for an eye of which the absolute coordinates and w add up to
    1, the first one by its share.
    """
    floats, shorts = arena.view(np.float32), arena.view(np.int16)
    row = (count + 7) // 8 * 8
    worst, size = np.zeros(4), np.zeros(4)
    values = np.zeros(count)
    for k in range(1, 4):
        column = 3 if k == 3 else (turn + k) % 3
        low, high = np.inf, -np.inf
        for i in range(count):
            if forced >> np.uint64(i) & np.uint64(1) == 0:
                values[i] = planes[own[i], column] / planes[own[i], turn] * scale
                low, high = min(low, values[i]), max(high, values[i])
        if low > high:
            continue
        floats[at + PLANE + k] = 0.5 * (low + high)
        middle = np.float64(floats[at + PLANE + k])
        floats[at + STEP + k] = max(high - middle, middle - low) * (1.0 + 1e-6) / LARGEST + 1e-30
        step = np.float64(floats[at + STEP + k])
        size[k] = (abs(middle) + LARGEST * step) / scale
        for i in range(count):
            if forced >> np.uint64(i) & np.uint64(1) == 0:
                number = np.round((values[i] - middle) / step)
                shorts[2 * (at + HEAD_WORDS) + (k - 1) * row + i] = np.int16(number)
                worst[k] = max(worst[k], abs(middle + number * step - values[i]))
    largest = max(1.0, size[1], size[2])
    turned = 3.5 * NORMAL_ERROR * largest * largest
    of_normals = max(worst[1], worst[2]) + (PLANE_ERROR * largest + turned) * scale
    of_normals = max(of_normals, PLANE_ERROR / FIRST_SHARE * scale)
    return max(of_normals, worst[3] + (PLANE_ERROR * size[3] + 1.5 * turned * reach) * scale) * _ROUNDED_UP


@njit(cache=True)
def _pack_planes(planes, own, count, reach, arena, at, lane):
    """Planes (f, 4) f8 of the faces own[:count] into the leaf at word `at`; returns the turn. reach: the largest |position|.

    lane: the word where the head keeps its own planes if some faces are always decided exactly.
    """
    floats = arena.view(np.float32)
    turn = _turn_of(planes, own, count)
    forced, flipped = _bits_of(planes, own, count, turn)
    scale, error = np.float32(1.0), np.inf
    while error > 1.0:
        unscaled = _put_planes(planes, own, count, forced, turn, reach, np.float64(scale), arena, at) / np.float64(scale)
        # other scales round a little otherwise, and few leaves need a third
        scale = np.float32((1.0 - 2.0**-8) / unscaled)
        error = _put_planes(planes, own, count, forced, turn, reach, np.float64(scale), arena, at)
    floats[at + PLANE] = scale
    if forced:
        head = floats[at + PLANE : at + PLANE + PLANE_WORDS]
        floats[lane : lane + PLANE_WORDS] = head
        head[:] = 0.0
    _put_word(arena, at + FORCED, forced)
    _put_word(arena, at + FLIPPED, flipped)
    return turn


@njit(cache=True)
def _put_word(arena, at, word):
    arena[at] = np.int32(np.uint32(word & np.uint64(0xFFFFFFFF)))
    arena[at + 1] = np.int32(np.uint32(word >> np.uint64(32)))


@njit(cache=True)
def _number(value, mark, known, own):
    """(number of a value in own[:known], the new length): appended when it is not there. mark names the place if there is one."""
    m = mark[value]
    if 0 <= m < known and own[m] == value:
        return m, known
    mark[value] = known
    own[known] = value
    return known, known + 1


@njit(cache=True)
def pack_leaves(record, first_word, order, edge_vertices, edge_faces, corners, planes, reach, face_mark, vertex_mark, arena, lane):
    """All leaves of record (l, COLUMNS) i4 into arena, from word first_word on, and from word lane on what `tree_walk` says of CORNERS.

    corners (f, 3) i4 of all faces, planes (f, 4) f8 of `unit_planes`, reach: the largest |position|; the marks (f,) and (v,) i4 are
    scratch, any content.
    """
    bytes_ = arena.view(np.uint8)
    own_faces, own_vertices = np.empty(ALL, np.int32), np.empty(2 * ALL, np.int32)
    for leaf in range(record.shape[0]):
        at = first_word + LINE * record[leaf, AT]
        count, edges = record[leaf, FACES], record[leaf, EDGES]
        ends = at + HEAD_WORDS + 12 * ((count + 7) // 8)
        row = (edges + 15) // 16 * 4
        listed, faces, vertices = lane + PLANE_WORDS, 0, 0
        for i in range(edges):
            e = order[record[leaf, START] + i]
            for side in range(2):
                m, faces = _number(edge_faces[e, side], face_mark, faces, own_faces)
                bytes_[4 * (ends + side * row) + i] = m
                m, vertices = _number(edge_vertices[e, side], vertex_mark, vertices, own_vertices)
                bytes_[4 * (ends + (2 + side) * row) + i] = m
        arena[ends + 4 * row : ends + 4 * row + vertices] = own_vertices[:vertices]
        for m in range(faces):
            arena[listed + 3 * m : listed + 3 * m + 3] = corners[own_faces[m]]
        turn = _pack_planes(planes, own_faces, faces, reach, arena, at, lane)
        counts = faces | edges << EDGES_BITS | vertices << VERTICES_BITS | turn << TURN_BITS | record[leaf, MORE] << MORE_BIT
        arena[at + COUNTS] = counts
        arena[at + CORNERS] = listed
        lane = listed + 3 * faces
