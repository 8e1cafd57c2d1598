"""Whether something grows: processes watched while they work, and slopes of what was seen, with how sure they are."""

from __future__ import annotations

import os
import re
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from scipy.stats import theilslopes

BLOCK_S = 30.0
"""What is seen within so long hangs together, and is drawn again together."""
ROUNDS = 400
SURE = 0.95
LEAST_SEEN = 12

Sample = dict[str, float]
"""Name of what was looked at -> value."""


@dataclass(frozen=True)
class Slope:
    """Growth over time, a minute. low, high: bounds within which it is, 19 times of 20."""

    a_minute: float
    low: float
    high: float

    @property
    def may_be_none(self) -> bool:
        """Whether what was seen does not show growth."""
        return self.low <= 0.0


def slope_of(seconds: Sequence[float], values: Sequence[float], seed: int = 0) -> Slope | None:
    """The Theil-Sen slope and its bounds by moving blocks of what the line leaves; None of too few values to tell.

    Based on: Sen, Estimates of the regression coefficient based on Kendall's tau, 1968; Künsch, The jackknife and the bootstrap for
    general stationary observations, 1989 (blocks, since neighbours in time are alike).
    """
    t, y = np.asarray(seconds, float) / 60.0, np.asarray(values, float)
    if len(t) < LEAST_SEEN:
        return None
    slope, start = theilslopes(y, t)[:2]
    left, chance = y - (start + slope * t), np.random.default_rng(seed)
    block = max(2, min(len(t) // 4, round(BLOCK_S / 60.0 / max(float(np.median(np.diff(t))), 1e-9))))
    count = -(-len(t) // block)
    again = []
    for _ in range(ROUNDS):
        begins = chance.integers(0, len(t) - block + 1, count)
        drawn = left[(begins[:, None] + np.arange(block)).ravel()[: len(t)]]
        again.append(_least_squares(t, drawn))
    spread = np.quantile(again, [(1 - SURE) / 2, (1 + SURE) / 2])
    return Slope(float(slope), float(slope + spread[0]), float(slope + spread[1]))


def _least_squares(t: np.ndarray, y: np.ndarray) -> float:
    """Slope of the line of least squares: of what a robust line left it spreads at least as far, and it is quick."""
    centred = t - t.mean()
    return float(centred @ y / (centred @ centred))


@dataclass
class Watch:
    """Looks at something again and again in a thread, from entering to leaving. look: what there is now; what raises OSError is left out.

    seconds: of `perf_counter`, when `samples` were taken.
    """

    look: Callable[[], Sample]
    every_s: float = 1.0
    seconds: list[float] = field(default_factory=list)
    samples: list[Sample] = field(default_factory=list)

    def __enter__(self) -> Watch:
        self._end = threading.Event()
        self._thread = threading.Thread(target=self._run, name="watch", daemon=True)
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._end.set()
        self._thread.join()

    def since(self, start: float) -> dict[str, tuple[list[float], list[float]]]:
        """Of every name that was seen since a time of `perf_counter`: (seconds, values)."""
        seen: dict[str, tuple[list[float], list[float]]] = {}
        for second, sample in zip(self.seconds, self.samples, strict=True):
            if second >= start:
                for name, value in sample.items():
                    times, values = seen.setdefault(name, ([], []))
                    times.append(second)
                    values.append(value)
        return seen

    def _run(self) -> None:
        while not self._end.wait(self.every_s):
            try:
                sample = self.look()
            except OSError:
                continue
            self.seconds.append(time.perf_counter())
            self.samples.append(sample)


def memory_mib(pid: int) -> tuple[float, float]:
    """MiB of a process that are resident, and of these what no file holds. Raises OSError when it is gone."""
    text = Path(f"/proc/{pid}/status").read_text()
    resident, own = (re.search(rf"^{name}:\s+(\d+) kB", text, re.MULTILINE) for name in ("VmRSS", "RssAnon"))
    return (float(resident[1]) / 1024 if resident else 0.0), (float(own[1]) / 1024 if own else 0.0)


def open_files(pid: int) -> int:
    """How many files and connections a process has open. Raises OSError when it is gone."""
    return len(os.listdir(f"/proc/{pid}/fd"))  # noqa: PTH208 - only counted


def threads(pid: int) -> int:
    """How many threads a process has. Raises OSError when it is gone."""
    return len(os.listdir(f"/proc/{pid}/task"))  # noqa: PTH208


def files_under(folder: Path) -> int:
    """How many files there are in a folder and below; none when it is gone."""
    return sum(len(names) for _, _, names in os.walk(folder))
