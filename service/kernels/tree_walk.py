"""The walk of a packed silhouette forest: node blocks first, then the leaves they let through.

Based on: Silhouette Clipping, section 5 (runtime algorithm). Departures: eight cones, sixteen faces and 64 edges a test; the
traversal is a queue, breadth first, with hardly a branch that depends on the data. A leaf's faces are tested once each,
whatever the number of their edges: by planes of 16 bits with an error bound, and by `geometry.predicates` where that is not
sure. What is visited is fetched ahead, and lies in as few cache lines as may be (`service.kernels.tree_walk_pack`).

Why a culled node hides nothing: the stored float32 cones are sound as exact cones (`worker.kernels.cones`), and all rounding
of the test here, of the eye included, stays below CONE_ERROR (|p| + |anchor|) |scaled normal|.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numba.cpython.unsafe.numbers import trailing_zeros

from geometry.predicates import is_front_facing
from service.kernels.intrinsics import fetch_ahead
from service.kernels.tree_walk_lanes import BIT_COUNT, SET_BITS, append_lanes, missed_cones
from service.kernels.tree_walk_leaf import (
    ALL,
    SIXTEEN,
    WIDE,
    bits_at,
    byte_at,
    close_faces,
    face_sides,
    first_pairs,
    float_at,
    leaf_eye,
    look_up,
    ones,
)

CONE_ERROR = 2.0**-19
"""32 u, of which the test's roundings use at most 20."""
PLANE_ERROR = 2.0**-20
"""Of a face's test in float32: 16 u times the square of the largest coefficient m of a leaf's planes (1, b, c). At most 12
roundings of terms of at most m take 12 u m; a unit normal is known to 2^-3 u, which grows to u m^2 where one component of it
is made 1: 13 u m^2 together."""

LINE = 16  # words in a cache line
BELOW, LEAF, MASKS, NEXT, BLOCK_WORDS = 96, 104, 112, 113, 128
"""Words of a node block: NODE_ROWS rows of cones, then per lane the block with its children and the line of its first leaf
(-1: none); bits of the lanes that have a block below, of those that have leaves, lanes in use, a byte each; next block, -1."""
EDGES_BITS, VERTICES_BITS, TURN_BITS, MORE_BIT = 8, 16, 24, 26
"""Of a leaf's counts: faces in the lowest byte, edges, vertices, by how much the eye's coordinates are turned, and whether the
next leaf is of the same node."""
PLANE, STEP, ERROR, ALARM, COUNTS, FACE_LANE, FORCED, FLIPPED, HEAD_WORDS = 0, 4, 8, 9, 10, 11, 12, 14, 16
"""Words of a leaf's head: its plane and the steps of the 16-bit differences from it (four words each, of which the plane's
first is 1 and the steps' first is 0), the larger of the errors of normals and distances, the same or infinity where some faces
are always decided exactly, counts, the word where the leaf's faces are listed, and the bits of the faces that are always
decided exactly and of those whose plane is stored turned round, two words each."""

FARTHEST_EYE = 1e14
"""Normalised units: beyond, squares of scaled normals times the eye could overflow float32; such eyes are brute force."""
SHORTEST_DIRECTION = 1e-100
SPARE_EDGES = 64
"""Of an output: a leaf's edges are stored sixteen at a time."""
AT_INFINITY = 1e-30  # stands for the fourth coordinate where a separation counts: 3e38 still keeps every eye out

_BITS = SET_BITS.ravel()
_BYTE = np.uint64(0xFF)
_ONE = np.uint64(1)
_FULL = np.uint64(0xFFFFFFFFFFFFFFFF)
_AHEAD, _LINES = 4, 10  # leaves whose first lines are asked for ahead


@njit(cache=True, nogil=True)
def visit_nodes(arena, blocks, leaves, x, y, z, w, w_back, margin):
    """Fill leaves with the words of arena that name the leaves to test; returns (their number, cones tested).

    (x, y, z, w) f4 the eye; w_back and margin as in `missed_cones`. blocks i4 is the queue.
    """
    head, tail, found, tested = 0, 0, 0, 0
    at = np.intp(0)
    while True:
        while at >= 0:
            masks = arena[at + MASKS]
            missed = missed_cones(arena, at, x, y, z, w, w_back, margin)
            tested += masks >> 16
            mask = np.intp(missed & np.uint64(masks & 0xFF))
            append_lanes(blocks, tail, _BITS, mask, np.int32(at + BELOW))
            tail += np.intp(BIT_COUNT[mask])
            mask = np.intp(missed & np.uint64((masks >> 8) & 0xFF))
            append_lanes(leaves, found, _BITS, mask, np.int32(at + LEAF))
            found += np.intp(BIT_COUNT[mask])
            at = np.intp(arena[at + NEXT])
        if head == tail:
            return found, tested
        at = np.intp(arena[blocks[head]])
        head += 1


@njit(cache=True)
def _settle(front, doubtful, arena, lane, positions, faces, eye):
    """Decide the doubtful faces of a leaf exactly; returns its front word complete. The faces stand in arena from lane on."""
    while doubtful:
        k = trailing_zeros(doubtful)
        doubtful &= doubtful - _ONE
        front &= ~(_ONE << k)
        if is_front_facing(positions, faces, arena[lane + np.int64(k)], eye):
            front |= _ONE << k
    return front


@njit(cache=True, inline="always")
def _first(count):
    """Word with the first `count` bits set, 1 to 64."""
    return _FULL >> np.uint64(64 - count)


@njit(cache=True)
def _emit(arena, ends, row, table, left, chosen, pairs, out, count):
    """Append the chosen edges to out (directed: the front-facing side on the left); returns the new number."""
    if WIDE:
        first_pairs(arena, ends, row, left, chosen, out, 2 * count, pairs)
        new = ones(chosen)
        for at in range(SIXTEEN, new, SIXTEEN // 2):
            look_up(arena, table, pairs, at // 2, out, 2 * (count + at))
        return count + new
    while chosen:
        k = np.int64(trailing_zeros(chosen))
        onward = (left >> np.uint64(k)) & _ONE
        chosen &= chosen - _ONE
        first, second = arena[table + byte_at(arena, ends, k)], arena[table + byte_at(arena, ends + row, k)]
        out[2 * count] = first if onward else second
        out[2 * count + 1] = second if onward else first
        count += 1
    return count


@njit(cache=True, nogil=True)
def visit_leaves(arena, leaves, positions, faces, eye, eyes, out):
    """Directed silhouette edges into out (flat i4, 2 * SPARE_EDGES spare); returns (their number, edges tested).

    leaves i4, not empty: as `visit_nodes` left them. eye (4,) f8 exact, eyes (12,) f4 as in `leaf_eye`.
    """
    count, tested = 0, 0
    pairs = np.empty(2 * LINE, np.int32)
    reach = reach_of(eyes)
    last = leaves.shape[0] - 1
    for i in range(leaves.shape[0]):
        coming = LINE * np.intp(arena[leaves[min(i + _AHEAD, last)]])
        for k in range(_LINES):
            fetch_ahead(arena, coming + LINE * k)
        at = LINE * np.intp(arena[leaves[i]])
        more = True
        while more:
            counts = arena[at + COUNTS]
            own_faces, own_edges, own_vertices = counts & 0xFF, (counts >> EDGES_BITS) & 0xFF, (counts >> VERTICES_BITS) & 0xFF
            front, doubtful = leaf_sides(arena, at, counts, eyes, reach)
            if doubtful:
                front = _settle(front, doubtful, arena, np.intp(arena[at + FACE_LANE]), positions, faces, eye)
            ends = at + HEAD_WORDS + 12 * ((own_faces + 7) >> 3)
            row = ((own_edges + 15) >> 4) << 2
            left = bits_at(arena, ends, front)
            chosen = (left ^ bits_at(arena, ends + row, front)) & _first(own_edges)
            table = ends + 4 * row
            count = _emit(arena, ends + 2 * row, row, table, left, chosen, pairs, out, count)
            tested += own_edges
            more = (counts >> MORE_BIT) != 0
            at = (table + own_vertices + LINE - 1) & ~(LINE - 1)
    return count, tested


@njit(cache=True, inline="always")
def _word_of(arena, at):
    return np.uint64(np.uint32(arena[at])) | (np.uint64(np.uint32(arena[at + 1])) << np.uint64(32))


@njit(cache=True)
def reach_of(eyes):
    """|x| + |y| + |z| + w, f4, of `turned_eyes`: a leaf's error times it bounds the error of a face's height."""
    return abs(eyes[0]) + abs(eyes[1]) + abs(eyes[2]) + eyes[3]


@njit(cache=True, inline="always")
def leaf_sides(arena, at, counts, eyes, reach):
    """(faces that are front, faces that are doubtful) of the leaf at word `at`, as bits.

    counts: its word COUNTS, eyes (12,) f4 of `turned_eyes`, reach f4 of `reach_of`.
    """
    own_faces = counts & 0xFF
    base, b, c, d = leaf_eye(arena, at, eyes, (counts >> TURN_BITS) & 3)
    row = ((own_faces + 7) >> 3) << 2
    over, some = face_sides(arena, at + HEAD_WORDS, row, base, b, c, d, float_at(arena, at + ALARM) * reach)
    doubtful = np.uint64(0)
    if some:  # hardly ever; then the list of the faces is asked for while they are told apart
        for k in range(ALL // LINE):
            fetch_ahead(arena, np.intp(arena[at + FACE_LANE]) + LINE * k)
        close = close_faces(arena, at + HEAD_WORDS, row, base, b, c, d, float_at(arena, at + ERROR) * reach)
        doubtful = (close | _word_of(arena, at + FORCED)) & _first(own_faces)
    return over ^ _word_of(arena, at + FLIPPED), doubtful


@njit(cache=True)
def turned_eyes(eye):
    """(12,) f4: the eye (4,) f8 for float32, its coordinates turned by 0, 1 and 2; all zero when the eye is too far for that.

    A direction is made unit first.
    """
    length = math.sqrt(eye[0] * eye[0] + eye[1] * eye[1] + eye[2] * eye[2])
    eyes = np.zeros(12, np.float32)
    if not length < FARTHEST_EYE or (eye[3] == 0.0 and length < SHORTEST_DIRECTION):
        return eyes
    scale = 1.0 if eye[3] else 1.0 / length
    for turn in range(3):
        for k in range(3):
            eyes[4 * turn + k] = eye[(turn + k) % 3] * scale
        eyes[4 * turn + 3] = eye[3]
    return eyes


@njit(cache=True, nogil=True)
def open_nodes(arena, scratch, lanes, eye, eyes, farthest):
    """(leaves i4 in scratch, cones tested) of the eye (4,) f8; eyes of `turned_eyes`, farthest: the largest |anchor|.

    scratch i4: two queues of `lanes` each, then the output.
    """
    w = np.float32(eye[3])
    length = math.sqrt(np.float64(eyes[0]) ** 2 + np.float64(eyes[1]) ** 2 + np.float64(eyes[2]) ** 2)
    margin = np.float32(CONE_ERROR * (length * (1.0 + 1e-6) + w * farthest))
    w_back = w if w else np.float32(AT_INFINITY)
    leaves = scratch[lanes : 2 * lanes]
    found, cones = visit_nodes(arena, scratch[:lanes], leaves, eyes[0], eyes[1], eyes[2], w, w_back, margin)
    return leaves[:found], cones


@njit(cache=True, nogil=True)
def find_edges(arena, scratch, lanes, positions, faces, eye, farthest):
    """(edges, edges tested, cones tested) of a finite eye (4,) f8 in the normalised frame; the other arguments as `open_nodes`
    has them. The edges are left in the output part of scratch. Edges tested: -1 when the eye is too far, and nothing was done.
    """
    eyes = turned_eyes(eye)
    if eyes[0] == 0.0 and eyes[1] == 0.0 and eyes[2] == 0.0 and (eye[0] != 0.0 or eye[1] != 0.0 or eye[2] != 0.0):
        return 0, -1, 0
    leaves, cones = open_nodes(arena, scratch, lanes, eye, eyes, farthest)
    if leaves.shape[0] == 0:
        return 0, 0, cones
    count, tested = visit_leaves(arena, leaves, positions, faces, eye, eyes, scratch[2 * lanes :])
    return count, tested, cones


@njit(cache=True, nogil=True)
def walk(arena, scratch, lanes, positions, faces, eye, farthest):
    """(edges (s, 2) i4, edges tested, cones tested), as `find_edges`."""
    count, tested, cones = find_edges(arena, scratch, lanes, positions, faces, eye, farthest)
    return as_edges(scratch[2 * lanes :], count), tested, cones


@njit(cache=True, nogil=True)
def as_edges(out, count):
    """(count, 2) i4 copy of the first pairs of out."""
    edges = np.empty((count, 2), np.int32)
    put_edges(out, count, edges)
    return edges


@njit(cache=True, nogil=True)
def put_edges(out, count, edges):
    """The first pairs of out into edges[:count]."""
    for k in range(count):
        edges[k, 0], edges[k, 1] = out[2 * k], out[2 * k + 1]


@njit(cache=True, nogil=True)
def walk_many(arena, scratch, lanes, positions, faces, eyes, farthest):
    """(edges (s, 2) i4 of one eye after the other, (k, 3) i8: edges, edges tested and cones tested of each), as `find_edges`,
    for eyes (k, 4) f8."""
    numbers = np.empty((eyes.shape[0], 3), np.int64)
    edges, total = np.empty((0, 2), np.int32), 0
    for i in range(eyes.shape[0]):
        count, numbers[i, 1], numbers[i, 2] = find_edges(arena, scratch, lanes, positions, faces, eyes[i], farthest)
        numbers[i, 0] = count
        if total + count > edges.shape[0]:
            # room for the eyes to come, should they have a quarter more than those so far
            larger = np.empty(((total + count) * (5 * eyes.shape[0]) // (4 * (i + 1)) + count, 2), np.int32)
            larger[:total] = edges[:total]
            edges = larger
        put_edges(scratch[2 * lanes :], count, edges[total:])
        total += count
    return edges[:total], numbers
