"""Plots of the tables, in one style."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np

matplotlib.use("Agg")
from matplotlib import pyplot
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

COLORS = ("#9aa5b1", "#52606d", "#d9822b", "#7b61a8", "#137cbd", "#29a634")
RECORD = {"Software": None}  # no version in the file: the same figures give the same bytes
WIDTH, HEIGHT = 8.0, 4.5  # inches
DPI = 120


def axes(x_label: str, y_label: str, height: float = HEIGHT) -> tuple[Any, Any]:
    """A figure and its axes, with a grid."""
    figure, made = pyplot.subplots(figsize=(WIDTH, height), layout="constrained")
    made.set_xlabel(x_label)
    made.set_ylabel(y_label)
    made.grid(True, which="major", color="#d5dbe1", linewidth=0.8)
    made.set_axisbelow(True)
    made.spines[["top", "right"]].set_visible(False)
    return figure, made


def plain_logarithmic(axis: Any) -> None:
    """A logarithmic axis whose ticks are written as numbers, not as powers of ten."""
    axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:,g}"))
    axis.set_minor_formatter(NullFormatter())


def save(figure: Any, path: Path) -> None:
    """Write a figure as PNG and forget it."""
    figure.savefig(path, dpi=DPI, metadata=RECORD)
    pyplot.close(figure)


def bars(path: Path, groups: Sequence[str], series: dict[str, list[float | None]], y_label: str) -> None:
    """Grouped bars on a logarithmic axis, each with its value; None leaves a gap."""
    figure, made = axes("", y_label)
    width = 0.84 / len(series)
    for k, (label, values) in enumerate(series.items()):
        at = np.arange(len(groups)) + (k - (len(series) - 1) / 2.0) * width
        shown = [np.nan if value is None else value for value in values]
        drawn = made.bar(at, shown, width * 0.94, label=label, color=COLORS[k % len(COLORS)])
        made.bar_label(drawn, [_short(value) for value in values], fontsize=7, padding=1.5)
    made.set_yscale("log")
    made.margins(x=0.02, y=0.08)
    least = min(value for values in series.values() for value in values if value is not None)
    made.set_ylim(bottom=least / 2.0)
    plain_logarithmic(made.yaxis)
    made.set_xticks(np.arange(len(groups)), groups)
    made.tick_params(axis="x", length=0)
    made.grid(False, axis="x")
    figure.legend(loc="outside upper center", ncols=len(series), frameon=False, fontsize=9)
    save(figure, path)


def _short(value: float | None) -> str:
    return "" if value is None else f"{value:,.0f}" if value >= 100 else f"{value:.3g}"
