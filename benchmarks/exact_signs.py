"""Part of `benchmarks.exactness`: the sign of millions of orientations against the same in whole numbers."""

from __future__ import annotations

import numpy as np
from numba import njit

from benchmarks.report import Result
from geometry.predicates import _filtered_sign, orient_sign
from tests import degenerate, oracles_integer

CHUNK = 20_000


@njit(nogil=True)
def signs(corners, eyes, sign, unsure):  # noqa: ANN001, ANN201
    """sign (n,) i1 by the product's predicate, and unsure (n,) bool: what its filter leaves to exact arithmetic."""
    for n in range(len(corners)):
        a, b, c = corners[n, 0], corners[n, 1], corners[n, 2]
        x, y, z, w = eyes[n, 0], eyes[n, 1], eyes[n, 2], eyes[n, 3]
        sign[n] = orient_sign(a, b, c, x, y, z, w)
        filtered = _filtered_sign(
            np.float64(a[0]), np.float64(a[1]), np.float64(a[2]),
            np.float64(b[0]), np.float64(b[1]), np.float64(b[2]),
            np.float64(c[0]), np.float64(c[1]), np.float64(c[2]),
            x, y, z, w,
        )  # fmt: skip
        unsure[n] = filtered == 2


def count_chunk(family: int, seed: int, count: int) -> tuple[int, int, int, int]:
    """(signs, wrong ones, zeros, ones that the filter left) of one family, whose number it is."""
    corners, eyes = degenerate.FAMILIES[family](np.random.default_rng((family, seed)), count)
    sign, unsure = np.empty(count, np.int8), np.empty(count, np.bool_)
    signs(corners, eyes, sign, unsure)
    expected = oracles_integer.orientations(corners, eyes)
    return count, int((sign != expected).sum()), int((expected == 0).sum()), int(unsure.sum())


def tasks(total: int) -> list[tuple[int, int, int]]:
    """Arguments of `count_chunk` that make at least so many signs, as many of each family."""
    each = -(-total // len(degenerate.FAMILIES))
    sizes = [CHUNK] * (each // CHUNK) + ([each % CHUNK] if each % CHUNK else [])
    return [(family, seed, size) for family in range(len(degenerate.FAMILIES)) for seed, size in enumerate(sizes)]


def totals(parts: list[tuple[int, int, int]], found: list[tuple[int, int, int, int]]) -> list[Result]:
    """A row a family: signs, wrong, share of zeros and of calls that took exact arithmetic."""
    rows = []
    for number, family in enumerate(degenerate.FAMILIES):
        own = [counts for (which, _, _), counts in zip(parts, found, strict=True) if which == number]
        made, wrong, zeros, unsure = (sum(column) for column in zip(*own, strict=True))
        rows.append(
            {"family": family.__name__, "signs": made, "wrong": wrong, "zero_share": zeros / made, "exact_share": unsure / made},
        )
    return rows
