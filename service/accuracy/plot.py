"""The plot of a ladder: error against milliseconds, what is best for its time highlighted, as an SVG that needs nothing else."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from schemas.ladder import AccuracyReport, AccuracyRung
from service.accuracy import svg
from service.accuracy.axes import Axis, linear_axis, log_axis
from service.accuracy.labels import farthest_apart, spread

WIDTH = 900
TOP, BOTTOM = 116, 372
PANELS = ((62, 432), (506, 876))
"""Left and right ends of the two panels, pixels."""
LANE = 26
"""Pixels along one side of a panel that the numbers of a front stand in."""
ZERO = 16
"""Pixels between the errors that are 0 and the others."""
MARGIN = 24
KEY_Y, SIGNS_Y = BOTTOM + 62, BOTTOM + 84
TABLE_Y, ROW = BOTTOM + 116, 17
TABLES = (MARGIN, 462)
MOST_NAMED = 8
"""Points of a front that have a number; the others are highlighted only."""
WIDE_LETTER = 6.9
"""Pixels that a letter of ordinary text takes at most, on average."""
MANY = 40
"""Rungs from which on those beside the fronts are drawn small and faint."""
STYLES = {
    "original/none": ("#8c6d31", True),
    "original/msaa": ("#e6550d", True),
    "original/ssaa": ("#a63603", True),
    "original/coverage": ("#e0a050", True),
    "clipped/none": ("#4393c3", False),
    "clipped/line": ("#756bb1", False),
    "clipped/coverage": ("#1a7f37", False),
}
"""source/antialias -> colour, and whether its marker is a square: squares draw the original, circles the hull."""


@dataclass(frozen=True)
class Panel:
    """One of the two plots. front: numbers of the report's rungs, the fastest first. value: of a rung; told: the same in words.

    lane_y: where the front's numbers stand: at the side that no rung lies between the front and.
    """

    report: AccuracyReport
    x: Axis
    y: Axis
    front: list[int]
    value: Callable[[AccuracyRung], float]
    told: Callable[[AccuracyRung], str]
    lane_y: float

    def place(self, number: int) -> tuple[float, float]:
        """Where a rung lies, pixels."""
        rung = self.report.rungs[number]
        return self.x.at(rung.ms), self.y.at(self.value(rung))

    @property
    def named(self) -> list[int]:
        """Those of the front that have a number in the plot, which is their place here, from 1."""
        return [self.front[i] for i in farthest_apart([self.place(number) for number in self.front], MOST_NAMED)]


def accuracy_svg(report: AccuracyReport, faces: int | None = None) -> str:
    """The plot of a report: left the outline's error, right the shading's, both against the time of a frame. faces: of the mesh."""
    outline, shading = _outline(report), _shading(report)
    rows = max(len(outline.named), len(shading.named))
    parts = [svg.open_svg(WIDTH, TABLE_Y + ROW * rows + 16, f"Error against milliseconds of {report.name}"), *_head(report, faces)]
    parts += _panel(outline, "Outline: mean error of alpha, 0 to 1", "down is better")
    parts += _panel(shading, "Shading: PSNR, dB", "up is better")
    parts += [*_key(report), *_table(outline, "error", TABLES[0]), *_table(shading, "PSNR", TABLES[1]), "</svg>"]
    return "\n".join(parts)


def _outline(report: AccuracyReport) -> Panel:
    errors = [rung.alpha_error for rung in report.rungs]
    zero = float(BOTTOM - LANE - 4)
    has_zero = min(errors) <= 0.0
    y = log_axis(errors, zero - ZERO if has_zero else BOTTOM - LANE, TOP + 8, zero)
    return Panel(
        report, _time_axis(report, 0), y, report.pareto.outline, lambda r: r.alpha_error, lambda r: f"{r.alpha_error:.2g}", BOTTOM - 12
    )


def _shading(report: AccuracyReport) -> Panel:
    y = linear_axis([rung.psnr_db for rung in report.rungs], BOTTOM - 8, TOP + LANE)
    return Panel(report, _time_axis(report, 1), y, report.pareto.shading, lambda r: r.psnr_db, lambda r: f"{r.psnr_db:.1f} dB", TOP + 12)


def _time_axis(report: AccuracyReport, panel: int) -> Axis:
    return log_axis([rung.ms for rung in report.rungs], *map(float, PANELS[panel]))


def _head(report: AccuracyReport, faces: int | None) -> list[str]:
    of_mesh = "" if faces is None else f"{faces:,} faces · "
    measured = f"{of_mesh}{report.size} × {report.size} pixels · {report.views} views · against {report.samples**2} samples a pixel"
    how = "measured" if any(rung.ms_p95 is not None for rung in report.rungs) else "predicted"
    return [
        svg.text(MARGIN, 34, svg.shortened(f"What accuracy costs: {report.name}", 70), size=17, bold=True),
        svg.text(MARGIN, 54, measured, fill=svg.QUIET),
        svg.text(MARGIN, 71, svg.shortened(f"Times {how} on {report.device}", 130), fill=svg.QUIET),
    ]


def _panel(panel: Panel, title: str, better: str) -> list[str]:
    """Grid and axes, all rungs, then the front as steps with its rungs large and numbered."""
    left, right = panel.x.start, panel.x.end
    parts = [
        svg.text(left, TOP - 9, title, bold=True),
        svg.text(right, TOP - 9, better, anchor="end", size=11, fill=svg.QUIET),
        f'<rect x="{left}" y="{TOP}" width="{right - left}" height="{BOTTOM - TOP}" fill="{svg.GROUND}"/>',
    ]
    for tick, words in panel.x.ticks:
        at = panel.x.at(tick)
        parts += [svg.line(at, TOP, at, BOTTOM), svg.text(at, BOTTOM + 16, words, anchor="middle", size=11)]
    for tick, words in panel.y.ticks:
        at = panel.y.at(tick)
        parts += [svg.line(left, at, right, at), svg.text(left - 7, at + 4, words, anchor="end", size=11)]
    parts += [
        svg.line(left, BOTTOM, right, BOTTOM, svg.QUIET),
        svg.line(left, TOP, left, BOTTOM, svg.QUIET),
        svg.text((left + right) / 2, BOTTOM + 34, "milliseconds a frame", anchor="middle", size=11, fill=svg.QUIET),
    ]
    many = len(panel.report.rungs) > MANY
    beside = sorted(set(range(len(panel.report.rungs))) - set(panel.front))
    parts += [_point(panel, number, 2.7 if many else 4.0, 0.4 if many else 0.7) for number in beside]
    parts.append(svg.steps([panel.place(number) for number in panel.front], right))
    return parts + _leaders(panel) + [_point(panel, number, 5.5, 1.0) for number in panel.front] + _badges(panel)


def _point(panel: Panel, number: int, radius: float, opacity: float) -> str:
    rung = panel.report.rungs[number]
    color, square = STYLES[_style(rung)]
    bound = "" if rung.bound_px is None else f", outline certified to {rung.bound_px:.2g} px"
    told = f"{rung.name}: {_ms(rung)} ms, error {rung.alpha_error:.2g}, {rung.psnr_db:.1f} dB{bound}"
    x, y = panel.place(number)
    return svg.marker(x, y, radius, square=square, color=color, hollow=rung.level is not None, opacity=opacity, told=told)


def _lane(panel: Panel) -> list[float]:
    """Where the numbers of the named rungs stand along the panel's lane."""
    half = svg.BADGE_WIDTH / 2 + 2
    return spread([panel.place(n)[0] for n in panel.named], svg.BADGE_WIDTH + 3, panel.x.start + half, panel.x.end - half)


def _leaders(panel: Panel) -> list[str]:
    return [svg.line(*panel.place(n), at, panel.lane_y, svg.QUIET, 0.8) for n, at in zip(panel.named, _lane(panel), strict=True)]


def _badges(panel: Panel) -> list[str]:
    return [svg.badge(at, panel.lane_y, str(place)) for place, at in enumerate(_lane(panel), 1)]


def _key(report: AccuracyReport) -> list[str]:
    """What markers and lines are; only those that occur."""
    parts, x = [], MARGIN + 6.0
    for name, (color, square) in STYLES.items():
        if any(_style(rung) == name for rung in report.rungs):
            parts += [svg.marker(x, KEY_Y - 4, 5.0, square=square, color=color, hollow=False), svg.text(x + 11, KEY_Y, name)]
            x += 29.0 + WIDE_LETTER * len(name)
    x = MARGIN + 6.0
    if any(rung.level is not None for rung in report.rungs):
        color, square = STYLES["clipped/coverage"]
        parts.append(svg.marker(x, SIGNS_Y - 4, 4.5, square=square, color=color, hollow=True))
        parts.append(svg.text(x + 11, SIGNS_Y, "hollow: the outline is a coarser level's"))
        x += 300.0
    parts.append(svg.steps([(x - 6, SIGNS_Y - 1.0), (x + 6, SIGNS_Y - 8.0)], x + 14))
    return [*parts, svg.text(x + 22, SIGNS_Y, "best for the time: nothing faster is as exact")]


def _table(panel: Panel, quantity: str, left: float) -> list[str]:
    """The numbered rungs of a front in words."""
    parts = [
        svg.text(left + 60, TABLE_Y - 4, "ms", anchor="end", size=11, bold=True),
        svg.text(left + 118, TABLE_Y - 4, quantity, anchor="end", size=11, bold=True),
        svg.text(left + 130, TABLE_Y - 4, "drawn", size=11, bold=True),
    ]
    for row, number in enumerate(panel.named, 1):
        rung, y = panel.report.rungs[number], TABLE_Y + ROW * row - 3
        parts += [
            svg.badge(left + 10, y - 4, str(row)),
            svg.text(left + 60, y, _ms(rung), anchor="end", size=11),
            svg.text(left + 118, y, panel.told(rung), anchor="end", size=11),
            svg.text(left + 130, y, svg.shortened(rung.name, 52), size=11),
        ]
    return parts


def _ms(rung: AccuracyRung) -> str:
    """Three digits."""
    return f"{rung.ms:.2f}" if rung.ms < 10.0 else f"{rung.ms:.1f}" if rung.ms < 100.0 else f"{rung.ms:.0f}"


def _style(rung: AccuracyRung) -> str:
    return f"{rung.source.value}/{rung.antialias.value}"
