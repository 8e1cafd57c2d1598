"""The bars of this release beside what was measured: reads the JSON of the tables and says met or not.

    python -m benchmarks.summary DIR [--json]

Writes DIR/summary.json and DIR/summary.md.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from benchmarks.machine import sentence
from benchmarks.report import NONE, Result, markdown_table, number, ratio

Results = dict[str, Result]
"""Results of tables by name."""
Value = Callable[[Results], float | None]
MIB = 1024.0


@dataclass(frozen=True)
class Bar:
    """A demand: the value must be at least (or at most) a limit. value: from the results; None where it was not measured."""

    what: str
    on: str
    limit: float
    at_least: bool
    unit: str
    value: Value

    def met(self, value: float | None) -> bool | None:
        """Whether a value meets it; None for none."""
        if value is None:
            return None
        return value >= self.limit if self.at_least else value <= self.limit


def of(table: str, mesh: str, *keys: str | int) -> Value:
    """A value in a table's result of a mesh."""

    def value(results: Results) -> float | None:
        found = results.get(table, {}).get("meshes", {}).get(mesh)
        for key in keys:
            found = found.get(key) if isinstance(found, dict) else None
        return found

    return value


def over(table: str, mesh: str, slow: str, fast: str) -> Value:
    """A ratio of two values of one mesh."""
    return lambda results: ratio(of(table, mesh, slow)(results), of(table, mesh, fast)(results))


def of_hull(mesh: str, count: int, key: str, scale: float = 1.0) -> Value:
    """A value of our hull of so many faces."""

    def value(results: Results) -> float | None:
        rows = results.get("hulls", {}).get("meshes", {}).get(mesh, {}).get("ours", [])
        found = next((row[key] for row in rows if row["faces_requested"] == count), None)
        return None if found is None else scale * found

    return value


def _sum(table: str, key: str) -> Value:
    def value(results: Results) -> float | None:
        rows = results.get(table, {}).get("meshes", {}).values()
        return sum(row[key] for row in rows) if rows else None

    return value


def not_enclosing(results: Results) -> float | None:
    """How many of our hulls do not enclose; None where there are none."""
    rows = [row for mesh in results.get("hulls", {}).get("meshes", {}).values() for row in mesh["ours"]]
    return sum(not row["enclosed"] for row in rows) if rows else None


def bars() -> list[Bar]:
    """All demands, in the order of the page."""
    return [*_extraction(), *_hulls(), *_times(), *_frames(), *_accuracy()]


def _extraction() -> list[Bar]:
    limits = {
        "SIMD": ("brute_simd_us", {"bunny_closed": 4.0, "dragon_871k": 4.0, "knot": 8.0, "holes3": 16.0}),
        "scalar": ("brute_scalar_us", {"bunny_closed": 15.0, "knot": 25.0, "holes3": 50.0}),
    }
    made = [
        Bar(f"extraction: {kind} brute force / tree", mesh, limit, True, "x", over("table2", mesh, key, "tree_us"))
        for kind, (key, of_mesh) in limits.items()
        for mesh, limit in of_mesh.items()
    ]
    made.append(Bar("extraction: eyes with another silhouette than the exact one", "all", 0, False, "", _sum("table2", "mismatches")))
    made.append(Bar("greedy forest: tested edges", "bunny_closed", 10_256, False, "", of("table2", "bunny_closed", "stored_edges")))
    made.append(Bar("greedy forest: tested nodes", "bunny_closed", 4_282, False, "", of("table2", "bunny_closed", "stored_nodes")))
    return made


HULL_LIMITS = {
    "bunny_closed": {500: 9.0, 1000: 4.5, 4000: 1.3},
    "armadillo_86k": {500: 25.0, 1000: 13.0, 4000: 4.5},
    "3holes": {500: 9.0, 1000: 4.5, 4000: 0.7},
    "fandisk": {500: 1.9, 1000: 0.9, 4000: 0.2},
}
"""Most excess volume, percent, by faces of the hull."""


def _hulls() -> list[Bar]:
    made = [
        Bar(f"hull of {count} faces: excess volume", mesh, limit, False, "%", of_hull(mesh, count, "volume_excess", 100.0))
        for mesh, limits in HULL_LIMITS.items()
        for count, limit in limits.items()
    ]
    made.append(Bar("hulls that do not enclose", "all", 0, False, "", not_enclosing))
    made.append(Bar("hull of 500 faces: time", "bunny_closed", 5.0, False, "s", of_hull("bunny_closed", 500, "seconds")))
    made.append(Bar("hull of 4000 faces: time", "dragon_871k", 90.0, False, "s", of_hull("dragon_871k", 4000, "seconds")))
    made.append(Bar("hull of 4000 faces: memory", "dragon_871k", 3.0, False, "GiB", _gib("hulls", "dragon_871k", "our_mib")))
    return made


def _gib(table: str, mesh: str, key: str) -> Value:
    def value(results: Results) -> float | None:
        mib = of(table, mesh, key)(results)
        return None if mib is None else mib / MIB

    return value


def _times() -> list[Bar]:
    limits = {"bunny_closed": 12.0, "dragon_400k": 90.0, "dragon_871k": 180.0}
    return [
        Bar("preprocessing, warm, two cores", mesh, limit, False, "s", of("preprocessing", mesh, "two_core_seconds"))
        for mesh, limit in limits.items()
    ]


def _frames() -> list[Bar]:
    limits = {"bunny_closed": 4.4, "knot": 7.9, "holes3": 16.4, "dragon_400k": 15.0}
    pair = ("original_ms", "clipped_coverage_ms")
    what = "frame: original, no antialiasing / coverage"
    made = [Bar(what, mesh, limit, True, "x", over("table1", mesh, *pair)) for mesh, limit in limits.items()]
    against = over("table1", "bunny_closed", "original_msaa4_ms", "clipped_coverage_ms")
    return [*made, Bar("frame: original, 4x MSAA / coverage", "bunny_closed", 12.0, True, "x", against)]


ACCURACY_MESHES = ("bunny_closed", "dragon_400k", "knot", "holes3", "fandisk")


def _accuracy() -> list[Bar]:
    made = [
        Bar("alpha error of coverage on outline pixels", mesh, 0.008, False, "", _own(mesh, "clipped/coverage", "alpha_error"))
        for mesh in ACCURACY_MESHES
    ]
    made += [Bar("the same, of that of 4x MSAA", mesh, 1.0 / 3.0, False, "", _part_of_msaa(mesh)) for mesh in ACCURACY_MESHES]
    made += [
        Bar("RMSE of coverage's alpha", mesh, 0.015, False, "", _own(mesh, "clipped/coverage", "alpha_rmse")) for mesh in ACCURACY_MESHES
    ]
    made += [Bar("alpha error of lines", mesh, 0.06, False, "", _own(mesh, "clipped/line", "alpha_error")) for mesh in ACCURACY_MESHES]
    made += [
        Bar("stencil's pixels that differ, worst of 100 views", mesh, 1e-4, False, "", of("accuracy", mesh, "stencil", "worst"))
        for mesh in ACCURACY_MESHES
    ]
    for what, key, limit, at_least in PLANNER_BARS:
        made += [Bar(what, mesh, limit, at_least, "", of("accuracy", mesh, "planner", key)) for mesh in ACCURACY_MESHES]
    return made


PLANNER_BARS = (
    ("predicted frame times within 25 %", "within_25_percent", 0.9, True),
    ("planner's choices that are right", "right_choices", 0.9, True),
    ("planning, microseconds", "planning_us", 100.0, False),
)


def _own(mesh: str, rung: str, key: str) -> Value:
    """A value of a rung whose outline is the mesh's own."""

    def value(results: Results) -> float | None:
        rows = results.get("accuracy", {}).get("meshes", {}).get(mesh, {}).get("rungs", [])
        return next((row[key] for row in rows if f"{row['source']}/{row['antialias']}" == rung and row["level"] is None), None)

    return value


def _part_of_msaa(mesh: str) -> Value:
    ours, msaa = _own(mesh, "clipped/coverage", "alpha_error"), _own(mesh, "original/msaa", "alpha_error")
    return lambda results: ratio(ours(results), msaa(results))


def summarise(results: Results) -> Result:
    """{machine, quick, bars: [{what, on, bar, measured, met}], left_out, failed}."""
    rows = []
    for bar in bars():
        value = bar.value(results)
        limit = f"{'≥' if bar.at_least else '≤'} {bar.limit:,g} {bar.unit}".rstrip()
        rows.append({"what": bar.what, "on": bar.on, "bar": limit, "unit": bar.unit, "measured": value, "met": bar.met(value)})
    first = next(iter(results.values()), {})
    lost = {kind: {f"{name}, {mesh}": why for name, result in results.items() for mesh, why in result[kind].items()} for kind in LOST}
    return {"machine": first.get("machine"), "quick": any(result["quick"] for result in results.values()), "bars": rows} | lost


LOST = {"left_out": "Left out", "failed": "Failed"}
VERDICT = {True: "met", False: "**not met**", None: "not measured"}


def document(summary: Result) -> str:
    """The Markdown page."""
    rows = [[row["what"], row["on"], row["bar"], _measured(row), VERDICT[row["met"]]] for row in summary["bars"]]
    verdicts = [row["met"] for row in summary["bars"]]
    counts = f"{verdicts.count(True)} of {len(verdicts)} bars met, {verdicts.count(False)} not met, {verdicts.count(None)} not measured."
    parts = ["# Summary", counts, markdown_table(["what", "on", "bar", "measured", "verdict"], rows)]
    for key, title in LOST.items():
        parts += [f"{title}: {what}: {why}." for what, why in summary[key].items()]
    if summary["machine"]:
        parts.append(f"Measured on {sentence(summary['machine'])}")
    if summary["quick"]:
        parts.append("A quick run: too few rounds for the figures to mean much.")
    return "\n\n".join(parts) + "\n"


def _measured(row: Result) -> str:
    return NONE if row["measured"] is None else f"{number(row['measured'])} {row['unit']}".rstrip()


def read(folder: Path, names: tuple[str, ...] = ("table1", "table2", "hulls", "preprocessing", "accuracy")) -> Results:
    """The results of the tables in a folder, those that are there."""
    paths = {name: folder / f"{name}.json" for name in names}
    return {name: json.loads(path.read_text()) for name, path in paths.items() if path.exists()}


def write(folder: Path) -> str:
    """summary.json and summary.md in a folder, from the tables there; the page."""
    summary = summarise(read(folder))
    page = document(summary)
    (folder / "summary.json").write_text(json.dumps(summary, indent=1) + "\n")
    (folder / "summary.md").write_text(page)
    return page


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--json", action="store_true", help="print summary.json instead of the page")
    arguments = parser.parse_args()
    page = write(arguments.folder)
    print((arguments.folder / "summary.json").read_text() if arguments.json else page)


if __name__ == "__main__":
    main()
