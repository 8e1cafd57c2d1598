"""Axes of a plot: from values to pixels, with ticks at round numbers."""

from __future__ import annotations

import math
from dataclasses import dataclass

ROUND = (1.0, 2.0, 5.0)
"""Ticks are these times a power of ten."""
MOST_TICKS = 9
PADDING = 0.04
"""Of an axis, left free beyond the values at both ends."""
LEAST_FACTOR = 6.5
"""A logarithmic axis spans more than 2.5 squared, so that it has two ticks."""
FLOOR = 1e-6
"""Values at most this are nought, which a logarithmic axis has a place of its own for."""


@dataclass(frozen=True)
class Axis:
    """Values from low to high (their logarithms to base 10 where log) over the pixels from start to end.

    ticks: (value, its text). zero: pixel of the value 0 on a logarithmic axis; None where no value is.
    """

    low: float
    high: float
    start: float
    end: float
    log: bool
    ticks: tuple[tuple[float, str], ...]
    zero: float | None = None

    def at(self, value: float) -> float:
        """Where a value lies, pixels."""
        if self.log and value <= FLOOR:
            return self.start if self.zero is None else self.zero
        part = ((math.log10(value) if self.log else value) - self.low) / (self.high - self.low)
        return self.start + part * (self.end - self.start)


def log_axis(values: list[float], start: float, end: float, zero: float | None = None) -> Axis:
    """An axis for values that are not negative. zero: pixel for those that are 0."""
    logs = [math.log10(value) for value in values if value > FLOOR] or [0.0]
    low, high = _padded(min(logs), max(logs), math.log10(LEAST_FACTOR))
    steps = ROUND if high - low < MOST_TICKS / len(ROUND) else ROUND[:1]
    every = [step * 10.0**decade for decade in range(math.floor(low), math.ceil(high) + 1) for step in steps]
    within = [tick for tick in every if low <= math.log10(tick) <= high]
    thinned = within[:: math.ceil(len(within) / MOST_TICKS)]
    has_zero = zero is not None and len(logs) < len(values)
    ticks = [*([(0.0, "0")] if has_zero else []), *((tick, f"{tick:g}") for tick in thinned)]
    return Axis(low, high, start, end, True, tuple(ticks), zero if has_zero else None)


def linear_axis(values: list[float], start: float, end: float) -> Axis:
    """An axis for any values."""
    low, high = _padded(min(values), max(values), 1.0)
    decade = 10.0 ** math.floor(math.log10((high - low) / MOST_TICKS))
    step = next(decade * one for one in (*ROUND, 10.0) if (high - low) / (decade * one) <= MOST_TICKS)
    numbers = range(math.ceil(low / step), math.floor(high / step) + 1)
    return Axis(low, high, start, end, False, tuple((number * step, f"{number * step:.6g}") for number in numbers))


def _padded(low: float, high: float, least: float) -> tuple[float, float]:
    """The ends of an axis, which is at least so long."""
    free = max(PADDING * (high - low), 0.5 * (least - (high - low)))
    return low - free, high + free
