import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from geometry import long_integers as li
from tests import oracles

finite = st.floats(allow_nan=False, allow_infinity=False)


def long_of(values):
    """(carried sum of doubles, digits, lowest bit)."""
    low, high = li.NO_BITS, -li.NO_BITS
    for value in values:
        low, high = li.widen(low, high, value)
    n = li.digits_for(low, high)
    work = np.zeros(n + li.SPARE, np.int64)
    for value in values:
        li.add_double(work, 0, low, value, 1)
    li.carry(work, 0, n)
    return work, n, low


def whole(work, n):
    return sum(int(digit) << li.DIGIT * i for i, digit in enumerate(work[:n]))


def rational(work, n, low):
    return whole(work, n) * oracles._rational([2.0])[0] ** int(low)


@settings(max_examples=300, deadline=None)
@given(finite, finite)
def test_sums_of_two_doubles_are_exact(a, b):
    work, n, low = long_of([a, b])
    assert (a == b == 0.0) or rational(work, n, low) == sum(oracles._rational([a, b]))
    assert not work[n:].any()
    assert all(0 <= digit < 1 << li.DIGIT for digit in work[: n - 1]) and abs(int(work[n - 1])) < 1 << li.DIGIT


@settings(max_examples=300, deadline=None)
@given(finite, finite, finite, finite, st.sampled_from([1, -1]))
def test_products_are_exact_and_have_the_exact_sign(a, b, c, d, sign):
    (first, n, _), (second, m, _) = long_of([a, b]), long_of([c, d])
    work = np.concatenate([first[:n], second[:m], np.zeros(n + m, np.int64)])
    li.add_product(work, 0, n, n, m, sign, n + m)
    expected = sign * whole(first, n) * whole(second, m)
    assert whole(work[n + m :], n + m) == expected
    assert li.sign_of(work, n + m, n + m) == (expected > 0) - (expected < 0)


def test_the_longest_sums_of_products_fit_into_a_digit():
    longest = li.digits_for(-1074, 1024)
    # of three products of a minor, itself of two products, and a column
    assert 3 * 2 * longest * (1 << li.DIGIT) ** 2 < 1 << 63
