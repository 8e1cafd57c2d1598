"""Pareto fronts of error against time."""

from __future__ import annotations

from collections.abc import Sequence


def front(errors: Sequence[float], times: Sequence[float]) -> list[int]:
    """Numbers of the points that no other one beats in both, the fastest first. Of points that are equal in both, the first."""
    order = sorted(range(len(errors)), key=lambda i: (times[i], errors[i], i))
    found: list[int] = []
    for i in order:
        if not found or errors[i] < errors[found[-1]]:
            found.append(i)
    return found
