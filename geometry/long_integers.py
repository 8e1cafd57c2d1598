"""Exact arithmetic of doubles as long integers: whatever their exponents, nothing overflows, underflows or is rounded.

A number is `n` *digits* in an array work (k,) i8 from place `at` on: sum of work[at + i] 2^(DIGIT i), in units of a power of two that
the caller keeps. Digits may be negative and larger than 2^DIGIT until `carry` has run; it leaves them in [0, 2^DIGIT), the last one
with the sign. All numbers of a caller lie in one array, zeroed at first, so that no part of it need be an array of its own.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numba.cpython.unsafe.numbers import trailing_zeros

DIGIT = 24
"""Bits of a digit: 2^15 products of two digits fit into 63 bits, and no sum of products here has as many."""
SPARE = 2
"""Digits behind a number that `add_double` writes zeros to."""
NO_BITS = 1 << 20
"""Lowest bit of zero: above all others."""
_MASK = (1 << DIGIT) - 1
_MANTISSA = 53


@njit(cache=True, inline="always")
def _mantissa(x):
    """(m, e): x = m 2^e with a whole m of at most 53 bits."""
    fraction, exponent = math.frexp(x)
    return np.int64(fraction * 2.0**_MANTISSA), np.int64(exponent - _MANTISSA)


@njit(cache=True)
def widen(low, high, x):
    """(low, high) such that the bits of a finite f8 x are among the bits low to high - 1, as those before are.

    Starts with (NO_BITS, -NO_BITS), which is zero.
    """
    if x == 0.0:
        return low, high
    m, e = _mantissa(x)
    return min(low, e + np.int64(trailing_zeros(np.uint64(abs(m))))), max(high, e + _MANTISSA)


@njit(cache=True, inline="always")
def digits_for(low, high):
    """Digits of a sum of two doubles with bits from low to high - 1, in units of 2^low."""
    return max(high + 1 - low, 0) // DIGIT + 1


@njit(cache=True)
def add_double(work, at, low, x, sign):
    """Add sign x / 2^low for an f8 x that `widen` has seen; sign: 1 or -1."""
    if x == 0.0:
        return
    m, e = _mantissa(x)
    if m < 0:
        m, sign = -m, -sign
    shift = e - low
    if shift < 0:
        m, shift = m >> -shift, 0  # what is cut off is zeros
    at, shift = at + shift // DIGIT, shift % DIGIT
    work[at] += sign * ((m & _MASK) << shift)
    work[at + 1] += sign * (((m >> DIGIT) & _MASK) << shift)
    work[at + 2] += sign * ((m >> 2 * DIGIT) << shift)


@njit(cache=True)
def put_difference(work, at, n, low, a, b):
    """a - b, f8, in units of 2^low, into n zero digits."""
    add_double(work, at, low, a, 1)
    add_double(work, at, low, b, -1)
    carry(work, at, n)


@njit(cache=True)
def carry(work, at, n):
    """Bring n digits into [0, 2^DIGIT); the last keeps the sign."""
    over = 0
    for i in range(at, at + n - 1):
        digit = work[i] + over
        over = digit >> DIGIT
        work[i] = digit & _MASK
    work[at + n - 1] += over


@njit(cache=True)
def add_product(work, a, n, b, m, sign, total):
    """Add sign times the product of n digits at a and m digits at b, carried both, to the n + m digits at total."""
    for i in range(n):
        digit = sign * work[a + i]
        for j in range(m):
            work[total + i + j] += digit * work[b + j]


@njit(cache=True)
def sign_of(work, at, n):
    """-1, 0 or 1: the sign of n digits, which it carries."""
    carry(work, at, n)
    if work[at + n - 1] < 0:
        return -1
    for i in range(at, at + n):
        if work[i] != 0:
            return 1
    return 0
