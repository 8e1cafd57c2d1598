"""Union-find over faces with a direction, and over corners."""

from __future__ import annotations

import numpy as np
from numba import njit

from geometry.union_find import find_root


@njit(cache=True)
def _root(parent, parity, i):
    """(root of i, direction of i relative to it); paths are halved."""
    turn = False
    while parent[i] != i:
        up = parent[i]
        parity[i] ^= parity[up]
        parent[i] = parent[up]
        turn ^= parity[i]
        i = parent[i]
    return i, turn


@njit(cache=True)
def directions(pairs, differ, hard, face_count):
    """Directions that make neighbouring faces agree.

    pairs (k, 2) faces, differ (k,) bool whether exactly one of the two must be turned; the first `hard` of them must hold,
    the others do where they can. Returns (patch (f,) i8, turned (f,) bool relative to the patch's root, bad (f,) bool at the
    roots of patches whose own pairs contradict one another).
    """
    parent = np.arange(face_count)
    parity = np.zeros(face_count, np.bool_)
    bad = np.zeros(face_count, np.bool_)
    for k in range(len(pairs)):
        a, turn_a = _root(parent, parity, pairs[k, 0])
        b, turn_b = _root(parent, parity, pairs[k, 1])
        if a == b:
            if k < hard and (turn_a ^ turn_b) != differ[k]:
                bad[a] = True
            continue
        parent[b] = a
        parity[b] = turn_a ^ turn_b ^ differ[k]
        bad[a] |= bad[b]
    patch = np.empty(face_count, np.int64)
    turned = np.empty(face_count, np.bool_)
    for f in range(face_count):
        patch[f], turned[f] = _root(parent, parity, f)
    return patch, turned, bad


@njit(cache=True)
def fans(mates):
    """(3 f,) a number shared by the corners of one fan: those joined across paired half-edges. mates (3 f,) i8 or -1."""
    n = len(mates)
    parent = np.arange(n)
    for h in range(n):
        g = mates[h]
        if g > h:
            h_end, g_end = h - h % 3 + (h + 1) % 3, g - g % 3 + (g + 1) % 3
            a, b = find_root(parent, h), find_root(parent, g_end)
            if a != b:
                parent[max(a, b)] = min(a, b)
            a, b = find_root(parent, h_end), find_root(parent, g)
            if a != b:
                parent[max(a, b)] = min(a, b)
    fan = np.empty(n, np.int64)
    for c in range(n):
        fan[c] = find_root(parent, c)
    return fan
