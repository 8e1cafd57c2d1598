"""How many examples property tests make: `HARD_EXAMPLES=10` makes ten times as many, others every time."""

from __future__ import annotations

import os

from hypothesis import HealthCheck, settings

MORE = int(os.environ.get("HARD_EXAMPLES", "1"))


def examples(count):
    """So many examples of a test, the same every time unless more are asked for."""
    slow = [HealthCheck.too_slow, HealthCheck.data_too_large, HealthCheck.filter_too_much]
    return settings(max_examples=count * MORE, derandomize=MORE == 1, deadline=None, suppress_health_check=slow)
