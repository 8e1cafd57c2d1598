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

from geometry.predicates import sees_front
from service.kernels.intrinsics import fetch_ahead, unlikely
from service.kernels.tree_walk_lanes import BIT_COUNT, SET_BITS, append_lanes, missed_cones
from service.kernels.tree_walk_leaf import (
    SIXTEEN,
    SURE,
    WIDE,
    bits_at,
    byte_at,
    close_faces,
    face_sides,
    first_pairs,
    leaf_eye,
    look_up,
    ones,
)

CONE_ERROR = 2.0**-19
"""32 u, of which the test's roundings use at most 20."""
PLANE_ERROR = 7.5 * 2.0**-24
"""Of a face's test in float32, times the largest coefficients of a leaf's planes. Each of the four products with the plane is
rounded once, twice in their sum, and three times as the sixteen-bit differences are added; those take part in five roundings at
most; the eye itself is rounded once: 7 u of each coordinate's largest term, and half a unit for what is of second order."""

FIRST_SHARE = 0.5
"""The first coefficient of a leaf's planes is 1, and only its roundings make it wrong: its error counts by this share."""

LINE = 16  # words in a cache line
BELOW, LEAF, MASKS, NEXT, BLOCK_WORDS = 96, 104, 112, 113, 128
"""Words of a node block: NODE_ROWS rows of cones, then per lane the block with its children and the line of its first leaf
(-1: none); bits of the lanes that have a block below, of those that have leaves, lanes in use, a byte each; next block, -1."""
EDGES_BITS, VERTICES_BITS, TURN_BITS, MORE_BIT = 8, 16, 24, 26
"""Of a leaf's counts: faces in the lowest byte, edges, vertices, by how much the eye's coordinates are turned, and whether the
next leaf is of the same node."""
PLANE, STEP, COUNTS, CORNERS, FORCED, FLIPPED, HEAD_WORDS = 0, 4, 10, 11, 12, 14, 16
"""Words of a leaf's head: its plane and the steps of the 16-bit differences from it (four words each, of which the plane's
first is 1 in units of the leaf's error and the steps' first is 0), counts, the word where the corners of the leaf's faces are
listed, and the bits of the faces that are always decided exactly and of those whose plane is stored turned round, two words each.

Plane and steps are zero where some faces are always decided exactly, so that no height is sure; they then stand in front of the
corners, PLANE_WORDS before them."""
PLANE_WORDS = 8

FARTHEST_EYE = 1e14
"""Normalised units: beyond, squares of scaled normals times the eye could overflow float32; such eyes are brute force."""
SHORTEST_DIRECTION = 1e-100
SPARE_EDGES = 64
"""Of an output: a leaf's edges are stored sixteen at a time."""
AT_INFINITY = 1e-30  # stands for the fourth coordinate where a separation counts: 3e38 still keeps every eye out

_BITS = SET_BITS.ravel()
_ONE = np.uint64(1)
_FULL = np.uint64(0xFFFFFFFFFFFFFFFF)
_AHEAD, _LINES = 4, 10  # leaves whose first lines are asked for ahead
_TOGETHER = 16  # leaves with doubtful faces


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


@njit(cache=True, inline="always")
def _emit_leaf(arena, ends, edges, front, pairs, out, count):
    """As `_emit`, those of a leaf's edges that have one face in front and one not; its bytes begin at word ends."""
    row = ((edges + 15) >> 4) << 2
    left = bits_at(arena, ends, front)
    chosen = (left ^ bits_at(arena, ends + row, front)) & _first(edges)
    return _emit(arena, ends + 2 * row, row, ends + 4 * row, left, chosen, pairs, out, count)


@njit(cache=True, nogil=True)
def visit_leaves(arena, leaves, waiting, positions, eye, eyes, out):
    """Directed silhouette edges into out (flat i4, 2 * SPARE_EDGES spare); returns (their number, edges tested).

    leaves i4, not empty: as `visit_nodes` left them. eye (4,) f8 exact, eyes (12,) f4 as in `leaf_eye`. Leaves with faces that are
    not sure wait for the end, where the cache misses of deciding them come at once: waiting i4, room for every leaf.
    """
    count, tested, unsure = 0, 0, 0
    pairs = np.empty(2 * LINE + 4 * _TOGETHER, np.int32)
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
            front, alarm = leaf_sides(arena, at, counts, eyes)
            ends = at + HEAD_WORDS + 12 * ((own_faces + 7) >> 3)
            if unlikely(alarm):
                waiting[unsure] = at // LINE
                unsure += 1
            else:
                count = _emit_leaf(arena, ends, own_edges, front, pairs, out, count)
            tested += own_edges
            more = (counts >> MORE_BIT) != 0
            at = (ends + (((own_edges + 15) >> 4) << 4) + own_vertices + LINE - 1) & ~(LINE - 1)
    for begin in range(0, unsure, _TOGETHER):
        count = _settle(arena, waiting[begin : min(unsure, begin + _TOGETHER)], positions, eye, eyes, pairs, out, count)
    return count, tested


@njit(cache=True)
def _settle(arena, waiting, positions, eye, eyes, pairs, out, count):
    """Append the edges of up to _TOGETHER leaves, which begin at the cache lines `waiting`, their doubtful faces decided exactly;
    returns the new number."""
    sides = pairs[2 * LINE :].view(np.uint64)
    for i in range(waiting.shape[0]):
        at = LINE * np.intp(waiting[i])
        sides[2 * i], doubtful = sure_sides(arena, at, arena[at + COUNTS], eyes)
        sides[2 * i + 1] = doubtful
        while doubtful:
            corners = _corners_at(arena, at, doubtful)
            for k in range(3):
                fetch_ahead(positions, np.intp(arena[corners + k]))
            doubtful &= doubtful - _ONE
    for i in range(waiting.shape[0]):
        at = LINE * np.intp(waiting[i])
        front, doubtful, counts = sides[2 * i], sides[2 * i + 1], arena[at + COUNTS]
        while doubtful:
            corners = _corners_at(arena, at, doubtful)
            over = sees_front(positions, arena[corners], arena[corners + 1], arena[corners + 2], eye)
            front |= np.uint64(over) << trailing_zeros(doubtful)
            doubtful &= doubtful - _ONE
        ends = at + HEAD_WORDS + 12 * (((counts & 0xFF) + 7) >> 3)
        count = _emit_leaf(arena, ends, (counts >> EDGES_BITS) & 0xFF, front, pairs, out, count)
    return count


@njit(cache=True, inline="always")
def _corners_at(arena, at, doubtful):
    """Word where the corners of the first of the doubtful faces stand, for the leaf at word `at`."""
    return np.intp(arena[at + CORNERS]) + 3 * np.int64(trailing_zeros(doubtful))


@njit(cache=True, inline="always")
def _word_of(arena, at):
    return np.uint64(np.uint32(arena[at])) | (np.uint64(np.uint32(arena[at + 1])) << np.uint64(32))


@njit(cache=True, inline="always")
def leaf_sides(arena, at, counts, eyes):
    """(faces that are front in float32, as bits, whether some of them may be doubtful) of the leaf at word `at`.

    counts: its word COUNTS, eyes (12,) f4 of `turned_eyes`.
    """
    base, b, c, d = leaf_eye(arena, at, eyes, (counts >> TURN_BITS) & 3)
    row = (((counts & 0xFF) + 7) >> 3) << 2
    over, alarm = face_sides(arena, at + HEAD_WORDS, row, base, b, c, d)
    return over ^ _word_of(arena, at + FLIPPED), alarm


@njit(cache=True)
def sure_sides(arena, at, counts, eyes):
    """(faces that are surely front, faces that are doubtful) as bits; the arguments are those of `leaf_sides`."""
    forced = _word_of(arena, at + FORCED)
    plane = np.intp(arena[at + CORNERS]) - PLANE_WORDS if forced else at
    base, b, c, d = leaf_eye(arena, plane, eyes, (counts >> TURN_BITS) & 3)
    row = (((counts & 0xFF) + 7) >> 3) << 2
    over, close = close_faces(arena, at + HEAD_WORDS, row, base, b, c, d)
    doubtful = (close | forced) & _first(counts & 0xFF)
    return (over ^ _word_of(arena, at + FLIPPED)) & ~doubtful, doubtful


@njit(cache=True)
def turned_eyes(eye):
    """(12,) f4: the eye (4,) f8 as leaves are tested by, its coordinates turned by 0, 1 and 2; all zero when it is too far for that.

    Absolute values, the first one times FIRST_SHARE, add up to SURE: a height is off by at most that where planes are off by 1.
    """
    length = math.sqrt(eye[0] * eye[0] + eye[1] * eye[1] + eye[2] * eye[2])
    eyes = np.zeros(12, np.float32)
    if not length < FARTHEST_EYE or (eye[3] == 0.0 and length < SHORTEST_DIRECTION):
        return eyes
    for turn in range(3):
        first, second, third = abs(eye[turn]), abs(eye[(turn + 1) % 3]), abs(eye[(turn + 2) % 3])
        scale = SURE / (FIRST_SHARE * first + second + third + eye[3])
        for k in range(3):
            eyes[4 * turn + k] = eye[(turn + k) % 3] * scale
        eyes[4 * turn + 3] = eye[3] * scale
    return eyes


@njit(cache=True, nogil=True)
def open_nodes(arena, scratch, lanes, eye, farthest):
    """(leaves i4 in scratch, cones tested) of the eye (4,) f8, for which `turned_eyes` is not zero; farthest: the largest |anchor|.

    scratch i4: two queues of `lanes` each, then the output.
    """
    w = np.float32(eye[3])
    scale = 1.0 if eye[3] else 1.0 / math.sqrt(eye[0] * eye[0] + eye[1] * eye[1] + eye[2] * eye[2])
    x, y, z = np.float32(eye[0] * scale), np.float32(eye[1] * scale), np.float32(eye[2] * scale)
    length = math.sqrt(np.float64(x) ** 2 + np.float64(y) ** 2 + np.float64(z) ** 2)
    margin = np.float32(CONE_ERROR * (length * (1.0 + 1e-6) + w * farthest))
    w_back = w if w else np.float32(AT_INFINITY)
    leaves = scratch[lanes : 2 * lanes]
    found, cones = visit_nodes(arena, scratch[:lanes], leaves, x, y, z, w, w_back, margin)
    return leaves[:found], cones


@njit(cache=True, nogil=True)
def find_edges(arena, scratch, lanes, positions, eye, farthest):
    """(edges, edges tested, cones tested) of a finite eye (4,) f8 in the normalised frame; the other arguments as `open_nodes`
    has them. The edges are left in the output part of scratch. Edges tested: -1 when the eye is too far, and nothing was done.
    """
    eyes = turned_eyes(eye)
    if not eyes.any():
        return 0, -1, 0
    leaves, cones = open_nodes(arena, scratch, lanes, eye, farthest)
    if leaves.shape[0] == 0:
        return 0, 0, cones
    count, tested = visit_leaves(arena, leaves, scratch[:lanes], positions, eye, eyes, scratch[2 * lanes :])
    return count, tested, cones


@njit(cache=True, nogil=True)
def walk(arena, scratch, lanes, positions, eye, farthest):
    """(edges (s, 2) i4, edges tested, cones tested), as `find_edges`."""
    count, tested, cones = find_edges(arena, scratch, lanes, positions, eye, farthest)
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
def walk_many(arena, scratch, lanes, positions, eyes, farthest):
    """(edges (s, 2) i4 of one eye after the other, (k, 3) i8: edges, edges tested and cones tested of each), as `find_edges`,
    for eyes (k, 4) f8."""
    numbers = np.empty((eyes.shape[0], 3), np.int64)
    edges, total = np.empty((0, 2), np.int32), 0
    for i in range(eyes.shape[0]):
        count, numbers[i, 1], numbers[i, 2] = find_edges(arena, scratch, lanes, positions, eyes[i], farthest)
        numbers[i, 0] = count
        if total + count > edges.shape[0]:
            # room for the eyes to come, should they have a quarter more than those so far
            larger = np.empty(((total + count) * (5 * eyes.shape[0]) // (4 * (i + 1)) + count, 2), np.int32)
            larger[:total] = edges[:total]
            edges = larger
        put_edges(scratch[2 * lanes :], count, edges[total:])
        total += count
    return edges[:total], numbers
