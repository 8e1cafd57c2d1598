"""Are decisions exact, and what does that cost? Three parts, each of which must hold.

    python -m benchmarks.exactness [--json] [--signs 10000000] [--eyes 100000] [--seconds 10] [--meshes knot,holes3]

*signs*: the product's orientation of triangles and eyes, most of them made to be hard, against whole numbers of any length, and
the share that the float filter leaves to exact arithmetic. *cost*: the walk of a silhouette tree against the same code without
its filter and exact faces; each of 200 views by the one and the other in turn, for `--seconds` a mesh; medians, and the median
ratio. *eyes*: silhouettes of twelve hard meshes for eyes in awkward places, by the tree and three kinds of brute force, against
whole numbers. 0 of anything leaves its part out.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from concurrent.futures import Executor, ProcessPoolExecutor
from typing import Any

from benchmarks import exact_cost, exact_eyes, exact_signs
from benchmarks.isolated import SPAWN
from benchmarks.models import AbsentError
from benchmarks.report import Result, markdown_table, number, report

PROCESSES = 2
VIEWS = 200
SEED = 1


def _shared_out(processes: Executor, work: Callable[..., Any], parts: list[tuple[Any, ...]]) -> list[Any]:
    return list(processes.map(work, *zip(*parts, strict=True)))


def check_signs(processes: Executor, count: int) -> list[Result]:
    """Rows of `exact_signs`, one a family."""
    parts = exact_signs.tasks(count)
    return exact_signs.totals(parts, _shared_out(processes, exact_signs.count_chunk, parts))


def check_eyes(processes: Executor, count: int) -> list[Result]:
    """Rows of `exact_eyes`, one a mesh."""
    each = -(-count // len(exact_eyes.SHAPES))
    return _shared_out(processes, exact_eyes.count_mismatches, [(name, each, SEED) for name in exact_eyes.SHAPES])


def measure_cost(meshes: tuple[str, ...], seconds: float) -> tuple[list[Result], list[str]]:
    """(rows of `exact_cost`, one a mesh that is on this machine; words about the others)."""
    rows, absent, both = [], [], exact_cost.walks()
    for name in meshes:
        try:
            rows.append(exact_cost.measure(name, VIEWS, seconds, both))
        except AbsentError as fault:
            absent.append(str(fault))
    return rows, absent


def measure(signs: int, eyes: int, seconds: float, meshes: tuple[str, ...]) -> Result:
    """All parts, their bars, and seconds of each."""
    result: Result = {"signs": [], "cost": [], "eyes": [], "absent": [], "part_seconds": {}}
    begun = time.perf_counter()
    if seconds > 0.0:  # first, while nothing else of ours runs
        result["cost"], result["absent"] = measure_cost(meshes, seconds)
        begun = _told(result, "cost", begun)
    with ProcessPoolExecutor(PROCESSES, mp_context=SPAWN) as processes:
        if signs:
            result["signs"] = check_signs(processes, signs)
            begun = _told(result, "signs", begun)
        if eyes:
            result["eyes"] = check_eyes(processes, eyes)
            _told(result, "eyes", begun)
    return result | {"bars": bars(result)}


def _told(result: Result, part: str, begun: float) -> float:
    now = time.perf_counter()
    result["part_seconds"][part] = round(now - begun, 1)
    return now


def bars(result: Result) -> list[Result]:
    """What is demanded of each part that was run: name, value, limit, met."""
    found = []
    if result["signs"]:
        found.append(("wrong signs", sum(row["wrong"] for row in result["signs"]), 0))
    if result["eyes"]:
        found.append(("eyes with a wrong silhouette", sum(sum(row["mismatches"].values()) for row in result["eyes"]), 0))
    if result["cost"]:
        found.append(("time with exactness over time without, worst mesh", max(row["ratio"] for row in result["cost"]), exact_cost.BAR))
    return [{"name": name, "value": value, "limit": limit, "met": value <= limit} for name, value, limit in found]


def print_tables(result: Result) -> None:
    if result["signs"]:
        head = ["family", "signs", "wrong", "zero", "exact path"]
        rows = [
            [row["family"], number(row["signs"]), number(row["wrong"]), f"{row['zero_share']:.2%}", f"{row['exact_share']:.2%}"]
            for row in result["signs"]
        ]
        print(markdown_table(head, rows), "\n")
    if result["cost"]:
        head = ["mesh", "faces", "exact, us", "float only, us", "ratio", "faces tested", "decided exactly"]
        keys = ("faces", "exact_us", "float_us", "ratio", "faces_tested", "faces_decided_exactly")
        print(markdown_table(head, [[row["mesh"], *(number(row[key], 4) for key in keys)] for row in result["cost"]]), "\n")
    if result["eyes"]:
        head = ["mesh", "faces", "eyes", "silhouette edges", *(f"{way} wrong" for way in exact_eyes.WAYS)]
        rows = [
            [row["mesh"], *(number(row[key]) for key in ("faces", "eyes", "silhouette_edges")), *map(number, row["mismatches"].values())]
            for row in result["eyes"]
        ]
        print(markdown_table(head, rows), "\n")
    for word in result["absent"]:
        print(word)
    for bar in result["bars"]:
        print(f"{'met' if bar['met'] else 'NOT MET'}: {bar['name']}: {bar['value']} (at most {bar['limit']})")
    print("seconds:", ", ".join(f"{part} {seconds}" for part, seconds in result["part_seconds"].items()))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", action="store_true", help="one JSON object instead of tables")
    parser.add_argument("--signs", type=int, default=10_000_000)
    parser.add_argument("--eyes", type=int, default=100_000)
    parser.add_argument("--seconds", type=float, default=10.0, help="of timing a mesh")
    parser.add_argument("--meshes", default=",".join(exact_cost.MESHES), help="to time, by commas; as for other benchmarks")
    arguments = parser.parse_args()
    meshes = tuple(arguments.meshes.split(","))
    report(lambda: measure(arguments.signs, arguments.eyes, arguments.seconds, meshes), arguments.json, print_tables)


if __name__ == "__main__":
    main()
