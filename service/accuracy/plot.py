"""The plot of a ladder: error against milliseconds, the front highlighted, as an SVG that needs nothing else."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from xml.sax.saxutils import escape, quoteattr

from schemas.ladder import AccuracyReport, AccuracyRung

WIDTH, HEIGHT = 960, 640
TOP, BOTTOM = 96, 420
PANELS = ((72, 462), (552, 942))
"""Left and right ends of the two panels, pixels."""
LEGEND_Y = 486
ROW = 16
MOST_NAMED = 8
"""Points of a front that are named; the others are drawn."""
STYLES = {
    "original/none": ("#8c6d31", "square"),
    "original/msaa": ("#e6550d", "square"),
    "original/ssaa": ("#a63603", "square"),
    "original/coverage": ("#fd8d3c", "square"),
    "clipped/none": ("#6baed6", "circle"),
    "clipped/line": ("#756bb1", "circle"),
    "clipped/coverage": ("#1a7f37", "circle"),
}
"""Colour and marker of source/antialias: squares draw the original, circles the hull."""
FLOOR = 1e-4
"""Least error on the logarithmic axis; what is less lies on it."""


@dataclass(frozen=True)
class Axis:
    """Values to pixels. ticks: (value, its text)."""

    low: float
    high: float
    start: float
    end: float
    log: bool
    ticks: tuple[tuple[float, str], ...]

    def at(self, value: float) -> float:
        """Where a value lies, pixels."""
        if self.log:
            part = (math.log(max(value, self.low)) - math.log(self.low)) / (math.log(self.high) - math.log(self.low))
        else:
            part = (value - self.low) / (self.high - self.low)
        return self.start + part * (self.end - self.start)


def accuracy_svg(report: AccuracyReport) -> str:
    """The plot of a report: left the outline's error, right the shading's, both against the time of a frame."""
    x_ticks = _log_ticks(min(rung.ms for rung in report.rungs), max(rung.ms for rung in report.rungs))
    errors = [max(rung.alpha_error, FLOOR) for rung in report.rungs]
    y_ticks = _log_ticks(min(errors), max(errors))
    decibels = [rung.psnr_db for rung in report.rungs]
    left = _panel(report, PANELS[0], x_ticks, _axis(y_ticks), lambda rung: max(rung.alpha_error, FLOOR), report.pareto.outline, "a")
    right = _panel(
        report, PANELS[1], x_ticks, _linear_axis(min(decibels), max(decibels)), lambda rung: rung.psnr_db, report.pareto.shading, "b"
    )
    measured = f"{report.size} x {report.size} pixels, {report.views} views, against {report.samples**2} samples a pixel"
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{WIDTH}" height="{HEIGHT}" viewBox="0 0 {WIDTH} {HEIGHT}" '
        'font-family="system-ui, sans-serif" font-size="12" fill="#24292f">',
        f'<rect width="{WIDTH}" height="{HEIGHT}" rx="8" fill="#ffffff" stroke="#d0d7de"/>',
        _text(24, 34, f"What accuracy costs: {report.name}", size=18, weight=600),
        _text(24, 54, measured, fill="#57606a"),
        _text(24, 70, report.device, fill="#57606a"),
        _text(PANELS[0][0], TOP - 8, "Outline: mean error of alpha on its pixels (down is better)", weight=600),
        _text(PANELS[1][0], TOP - 8, "Shading: PSNR in decibels (up is better)", weight=600),
        *left, *right,
        *_key(), *_names(report, report.pareto.outline, PANELS[0][0], "a"), *_names(report, report.pareto.shading, PANELS[1][0], "b"),
        "</svg>",
    ]  # fmt: skip
    return "\n".join(parts)


def _panel(
    report: AccuracyReport, sides: tuple[int, int], x_ticks: Sequence[float], y: Axis, value: Callable[[AccuracyRung], float],
    best: Sequence[int], prefix: str,
) -> list[str]:  # fmt: skip
    """One plot: grid, all points small and faint, the front as steps and its points large and numbered."""
    left, right = sides
    x = Axis(x_ticks[0], x_ticks[-1], left, right, True, tuple((tick, _number(tick)) for tick in x_ticks))
    parts = [f'<rect x="{left}" y="{TOP}" width="{right - left}" height="{BOTTOM - TOP}" fill="#f6f8fa"/>']
    for tick, text in x.ticks:
        parts += [_line(x.at(tick), TOP, x.at(tick), BOTTOM, "#d8dee4"), _text(x.at(tick), BOTTOM + 16, text, anchor="middle")]
    for tick, text in y.ticks:
        parts += [_line(left, y.at(tick), right, y.at(tick), "#d8dee4"), _text(left - 6, y.at(tick) + 4, text, anchor="end")]
    parts.append(_text((left + right) / 2, BOTTOM + 34, "milliseconds a frame", anchor="middle", fill="#57606a"))
    many = len(report.rungs) > 40
    for number, rung in enumerate(report.rungs):
        if number not in best:
            parts.append(_point(x.at(rung.ms), y.at(value(rung)), rung, 2.5 if many else 4.0, 0.35 if many else 0.7))
    corners = [(x.at(report.rungs[i].ms), y.at(value(report.rungs[i]))) for i in best]
    path = " ".join(f"{'H' if k else 'M'} {px:.1f} {'V ' if k else ''}{py:.1f}" for k, (px, py) in enumerate(corners))
    parts.append(f'<path d="{path}" fill="none" stroke="#24292f" stroke-width="1.2" stroke-dasharray="4 3"/>')
    taken: list[tuple[float, float]] = []
    for place, (i, (px, py)) in enumerate(zip(best, corners, strict=True)):
        parts.append(_point(px, py, report.rungs[i], 5.5, 1.0))
        if place in _named(len(best)):
            parts += _mark(px, py, f"{prefix}{place + 1}", taken, left, right)
    return parts


def _named(count: int) -> list[int]:
    """Places of a front that are named: its ends, and evenly between."""
    if count <= MOST_NAMED:
        return list(range(count))
    return sorted({round(k * (count - 1) / (MOST_NAMED - 1)) for k in range(MOST_NAMED)})


def _mark(px: float, py: float, text: str, taken: list[tuple[float, float]], left: float, right: float) -> list[str]:
    """A point's number beside it, where no other number is."""
    offsets = [(10, -8), (10, 14), (-24, -8), (-24, 14), (10, -22), (10, 28), (-24, -22), (-24, 28), (26, -8), (26, 14), (-42, 3), (42, 3)]
    for dx, dy in offsets:
        x, y = px + dx, py + dy
        if all(abs(x - a) > 20 or abs(y - b) > 12 for a, b in taken) and left <= x <= right - 16 and TOP + 8 <= y <= BOTTOM - 2:
            break
    taken.append((x, y))
    return [_line(px, py, x + 6, y - 4, "#8c959f"), _text(x, y, text, weight=600)]


def _key() -> list[str]:
    """What the markers are."""
    parts, x = [], 24.0
    for name in STYLES:
        parts += [_marker(x + 5, LEGEND_Y - 4, name, 5.0, 1.0), _text(x + 15, LEGEND_Y, name)]
        x += 132
    return parts


def _names(report: AccuracyReport, best: Sequence[int], left: int, prefix: str) -> list[str]:
    """The points of a front that have numbers, in words."""
    parts = []
    for row, place in enumerate(_named(len(best))):
        rung = report.rungs[best[place]]
        value = f"error {_number(rung.alpha_error)}" if prefix == "a" else f"{rung.psnr_db:.1f} dB"
        text = f"{prefix}{place + 1}  {_number(rung.ms)} ms, {value}: {rung.name}"
        parts.append(_text(left - 48 if prefix == "a" else left - 30, LEGEND_Y + 22 + ROW * row, text, size=11))
    return parts


def _point(x: float, y: float, rung: AccuracyRung, radius: float, opacity: float) -> str:
    bound = "" if rung.bound_px is None else f", certified {rung.bound_px:.3g} px"
    told = f"{rung.name}: {rung.ms:.3g} ms, alpha error {rung.alpha_error:.3g}, {rung.psnr_db:.1f} dB{bound}"
    return f"<g><title>{escape(told)}</title>{_marker(x, y, f'{rung.source.value}/{rung.antialias.value}', radius, opacity)}</g>"


def _marker(x: float, y: float, style: str, radius: float, opacity: float) -> str:
    color, shape = STYLES[style]
    if shape == "square":
        place = f'x="{x - radius:.1f}" y="{y - radius:.1f}" width="{2 * radius}" height="{2 * radius}"'
        return f'<rect {place} fill="{color}" opacity="{opacity}"/>'
    return f'<circle cx="{x:.1f}" cy="{y:.1f}" r="{radius}" fill="{color}" opacity="{opacity}"/>'


def _axis(ticks: Sequence[float]) -> Axis:
    texts = tuple((tick, "0" if tick <= FLOOR else _number(tick)) for tick in ticks)
    return Axis(ticks[0], ticks[-1], BOTTOM, TOP, True, texts)


def _linear_axis(low: float, high: float) -> Axis:
    """From a multiple of its step to another."""
    step = next(s for s in (0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0) if (high - low) / s <= 8.0)
    first, last = math.floor(low / step) * step, math.ceil(high / step) * step
    last = last if last > first else first + step
    count = round((last - first) / step)
    return Axis(first, last, BOTTOM, TOP, False, tuple((first + k * step, f"{first + k * step:g}") for k in range(count + 1)))


def _log_ticks(low: float, high: float) -> list[float]:
    """1, 2, 5, 10, ... about the values; only powers of ten where these would be many."""
    low, high = max(low, FLOOR), max(high, 2.0 * FLOOR)
    decades = range(math.floor(math.log10(low)) - 1, math.ceil(math.log10(high)) + 2)
    steps = (1.0, 2.0, 5.0) if math.log10(high / low) < 2.5 else (1.0,)
    ticks = [step * 10.0**decade for decade in decades for step in steps]
    first = max(tick for tick in ticks if tick <= low * 1.0001)
    last = min(tick for tick in ticks if tick >= high * 0.9999 and tick > first)
    return [tick for tick in ticks if first <= tick <= last]


def _number(value: float) -> str:
    """Two or three digits, without an exponent where that reads well."""
    return f"{value:.3g}" if value >= 1.0 else f"{value:.2g}"


def _text(x: float, y: float, text: str, *, anchor: str = "start", size: int = 12, weight: int = 400, fill: str = "#24292f") -> str:
    style = f'text-anchor="{anchor}" font-size="{size}" font-weight="{weight}" fill={quoteattr(fill)}'
    return f'<text x="{x:.1f}" y="{y:.1f}" {style}>{escape(text)}</text>'


def _line(x0: float, y0: float, x1: float, y1: float, color: str) -> str:
    return f'<line x1="{x0:.1f}" y1="{y0:.1f}" x2="{x1:.1f}" y2="{y1:.1f}" stroke="{color}" stroke-width="0.8"/>'
