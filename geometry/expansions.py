"""Exact floating-point expansions: sums of doubles that do not overlap.

Based on: Shewchuk, "Adaptive Precision Floating-Point Arithmetic and Fast Robust Geometric Predicates" (1997), sections 2.2
to 2.5. Products are split by Dekker's method, so no fused multiply-add is assumed. Compiled without fastmath: reassociation
would destroy the error terms. Exact as long as no product of components leaves the range of normal doubles.
"""

from __future__ import annotations

import numpy as np
from numba import njit

_SPLITTER = 134217729.0  # 2^27 + 1


@njit(cache=True, inline="always")
def two_sum(a, b):
    """(x, y) with x = fl(a + b) and x + y = a + b exactly."""
    x = a + b
    bv = x - a
    return x, (a - (x - bv)) + (b - bv)


@njit(cache=True, inline="always")
def two_product(a, b):
    """(x, y) with x = fl(a b) and x + y = a b exactly."""
    x = a * b
    c = _SPLITTER * a
    ah = c - (c - a)
    al = a - ah
    c = _SPLITTER * b
    bh = c - (c - b)
    bl = b - bh
    return x, al * bl - (((x - ah * bh) - al * bh) - ah * bl)


@njit(cache=True)
def grow(e, n, b):
    """Add the double b to the n components of e in place (e has room for one more); returns the new count."""
    q = b
    k = 0
    for i in range(n):
        q, h = two_sum(q, e[i])
        if h != 0.0:
            e[k] = h
            k += 1
    if q != 0.0 or k == 0:
        e[k] = q
        k += 1
    return k


@njit(cache=True)
def add(e, n, f, m):
    """Add the m components of f to e in place (e has room for n + m); returns the new count."""
    for i in range(m):
        n = grow(e, n, f[i])
    return n


@njit(cache=True)
def multiply(e, n, f, m, out):
    """Product of two expansions into out (room for 2 n m); returns its count."""
    k = 0
    for i in range(n):
        for j in range(m):
            x, y = two_product(e[i], f[j])
            k = grow(out, k, y)
            k = grow(out, k, x)
    return k


@njit(cache=True)
def sign(e, n):
    """-1, 0 or 1: the sign of the largest component."""
    if n == 0 or e[n - 1] == 0.0:
        return 0
    return 1 if e[n - 1] > 0.0 else -1


@njit(cache=True)
def difference(a, b):
    """a - b as an expansion: (components (2,) f8, count)."""
    e = np.empty(2)
    x, y = two_sum(a, -b)
    if y == 0.0:
        e[0] = x
        return e, 1
    e[0], e[1] = y, x
    return e, 2
