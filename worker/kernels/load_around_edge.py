"""Faces in their order around an edge, decided exactly, and their pairing into manifold pairs that do not cross."""

from __future__ import annotations

import numpy as np
from numba import njit

from geometry.predicates import orient_sign
from worker.kernels.load_collinear import on_one_line, shadow_sign


@njit(cache=True)
def _side(p, a, b, c, q):
    """1 when q lies less than half a turn after c around a -> b, -1 when before, 0 in the same plane."""
    return orient_sign(p[a], p[b], p[c], np.float64(p[q, 0]), np.float64(p[q, 1]), np.float64(p[q, 2]), 1.0)


@njit(cache=True)
def _opposite(p, a, b, reference, q):
    """Whether q, in the plane of the other three, lies strictly beyond the line through a and b as seen from the reference."""
    for axis in range(3):
        side = shadow_sign(p[a], p[b], p[reference], axis)
        if side != 0:
            return side * shadow_sign(p[a], p[b], p[q], axis) < 0
    return False


@njit(cache=True)
def _quarter(p, a, b, reference, q):
    """0: at the reference, 1: in the half turn after it, 2: opposite, 3: in the half turn before it."""
    s = _side(p, a, b, reference, q)
    if s > 0:
        return 1
    if s < 0:
        return 3
    return 2 if _opposite(p, a, b, reference, q) else 0


@njit(cache=True)
def _comes_first(p, a, b, left, left_quarter, right, right_quarter, faces, forward):
    """Whether half-edge `left` comes before `right` around a -> b.

    Of coincident faces those that end a solid (forward) come first, so that touching bodies stay apart; beyond that the
    face numbers nest: what was opened last is closed first.
    """
    if left_quarter != right_quarter:
        return left_quarter < right_quarter
    if left_quarter == 1 or left_quarter == 3:
        s = _side(p, a, b, apex(faces, left), apex(faces, right))
        if s != 0:
            return s > 0
    if forward[left] != forward[right]:
        return forward[left]
    return left > right if forward[left] else left < right


@njit(cache=True)
def apex(faces, h):
    """The vertex of half-edge h's face that is not on it."""
    return faces[h // 3, (h + 2) % 3]


@njit(cache=True)
def sort_around(p, faces, forward, members):
    """Sort the half-edges `members` (n,) of one edge in place, counter-clockwise seen from its larger vertex."""
    h = members[0]
    a, b = faces[h // 3, h % 3], faces[h // 3, (h + 1) % 3]
    if a > b:
        a, b = b, a
    reference = apex(faces, h)
    for i in range(len(members)):
        if not on_one_line(p[a], p[b], p[apex(faces, members[i])]):
            reference = apex(faces, members[i])
            break
    quarters = np.empty(len(members), np.int64)
    for i in range(len(members)):
        h = members[i]
        quarter = _quarter(p, a, b, reference, apex(faces, h))
        j = i
        while j > 0 and _comes_first(p, a, b, h, quarter, members[j - 1], quarters[j - 1], faces, forward):
            members[j], quarters[j] = members[j - 1], quarters[j - 1]
            j -= 1
        members[j], quarters[j] = h, quarter


@njit(cache=True)
def _match(members, forward, joined, mates):
    """Pair what opens with what closes, like brackets on a ring; `joined` pairs across the gaps instead of the solids."""
    n = len(members)
    stack = np.empty(n, np.int64)
    top = 0
    for i in range(2 * n):
        h = members[i % n]
        if mates[h] >= 0:
            continue
        if forward[h] == joined:
            if i < n:
                stack[top] = h
                top += 1
        elif top > 0:
            top -= 1
            mates[h] = stack[top]
            mates[stack[top]] = h


@njit(cache=True)
def pair_half_edges(p, faces, forward, order, start, joined, most):
    """(3 f,) the half-edge across each half-edge, -1 where there is none.

    p (v, 3) f4, faces (f, 3) i8, forward/order/start as in `HalfEdges`, joined (e,) bool how to pair at edges of more than
    two faces. Edges of more than `most` faces, and unbalanced ones, get no pairs.
    """
    mates = np.full(len(order), -1, np.int64)
    for e in range(len(start) - 1):
        members = order[start[e] : start[e + 1]].copy()
        balance = 0
        for h in members:
            balance += 1 if forward[h] else -1
        if balance != 0 or len(members) > most:
            continue
        if len(members) > 2:
            sort_around(p, faces, forward, members)
        _match(members, forward, joined[e], mates)
    return mates


@njit(cache=True)
def neighbours_around(p, faces, forward, order, start, edges, most):
    """(k, 2) pairs of half-edges that follow one another around each of `edges`, the last and the first included."""
    total = 0
    for e in edges:
        n = start[e + 1] - start[e]
        if n <= most:
            total += n
    pairs = np.empty((total, 2), np.int64)
    k = 0
    for e in edges:
        members = order[start[e] : start[e + 1]].copy()
        n = len(members)
        if n > most:
            continue
        sort_around(p, faces, forward, members)
        for i in range(n):
            pairs[k, 0], pairs[k, 1] = members[i], members[(i + 1) % n]
            k += 1
    return pairs
