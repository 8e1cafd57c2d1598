"""Which points of a front are named, and where their names stand so that none hides another."""

from __future__ import annotations

import math
from collections.abc import Sequence


def farthest_apart(points: Sequence[tuple[float, float]], most: int) -> list[int]:
    """Numbers of at most so many of the points, in order: both ends, then always the one that is farthest from all chosen ones."""
    if len(points) <= most:
        return list(range(len(points)))
    chosen = [0, len(points) - 1]
    while len(chosen) < most:
        distance = [min(math.dist(point, points[c]) for c in chosen) for point in points]
        chosen.append(max(range(len(points)), key=distance.__getitem__))
    return sorted(chosen)


def spread(wanted: Sequence[float], apart: float, low: float, high: float) -> list[float]:
    """Places between low and high, in the order of those wanted (ascending) and at least `apart` from each other.

    As near as can be, in least squares: those that would be too near share the mean of their shifts. They must have room:
    (n - 1) * apart <= high - low.
    """
    pools: list[tuple[float, int]] = []  # (sum of shifts, how many share it); their means ascend
    for number, place in enumerate(wanted):
        total, count = place - number * apart, 1
        while pools and pools[-1][0] / pools[-1][1] >= total / count:
            before = pools.pop()
            total, count = total + before[0], count + before[1]
        pools.append((total, count))
    shifts = [total / count for total, count in pools for _ in range(count)]
    most = high - (len(shifts) - 1) * apart
    return [min(max(shift, low), most) + number * apart for number, shift in enumerate(shifts)]
