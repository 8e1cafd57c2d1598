"""How a table is made: each mesh measured in a process of its own, the result printed or written as JSON, Markdown and plots.

    python -m benchmarks.tables.NAME [MESH ...] [--quick] [--json] [--out DIR]

MESH are files or names that `benchmarks.models` knows; those of the paper if not given. --quick: few rounds, to see that it
runs. --out: writes NAME.json, NAME.md and NAME*.png there. A mesh that is absent is left out with a word, and one whose
measurement fails is too, but the program then ends with status 1.
"""

from __future__ import annotations

import argparse
import importlib.util
import json
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from benchmarks.isolated import FailedError, isolated
from benchmarks.machine import machine, sentence
from benchmarks.models import AbsentError, mesh_file
from benchmarks.report import Result

PICTURES = "pictures"
MEASURED_AT_MOST_S = 1500.0


@dataclass(frozen=True)
class Table:
    """A table or figure.

    measure: (mesh, quick) -> what was measured of one mesh; runs in a process of its own. What it holds under PICTURES is for
    the plot and not written as JSON. text: Markdown of a result, without its title. plot: writes pictures of a result into a
    folder and returns their names.
    """

    name: str
    title: str
    meshes: tuple[str, ...]
    measure: Callable[[str, bool], Result]
    text: Callable[[Result], str]
    plot: Callable[[Result, Path], list[str]] | None = None


def make(table: Table, meshes: list[str], quick: bool) -> Result:
    """{name, quick, machine, seconds, meshes: {mesh: measured}, left_out: {mesh: why}, failed: {mesh: why}}."""
    result: Result = {"name": table.name, "quick": quick, "machine": machine(), "meshes": {}, "left_out": {}, "failed": {}}
    begun = time.perf_counter()
    for mesh in meshes:
        name = Path(mesh).stem
        say(f"{table.name}: {name}")
        try:
            with mesh_file(mesh):
                pass
            measured, mib = isolated(table.measure, mesh, quick, limit_s=MEASURED_AT_MOST_S)
            result["meshes"][name] = measured | {"process_mib": mib}
        except AbsentError as absent:
            result["left_out"][name] = str(absent)
            say(f"  left out: {absent}")
        except FailedError as failed:
            result["failed"][name] = str(failed)
            say(f"  failed: {failed}")
    result["seconds"] = round(time.perf_counter() - begun, 1)
    return result


def as_json(result: Result, indent: int | None = None) -> str:
    """A result without its pictures."""
    meshes = {name: {key: value for key, value in row.items() if key != PICTURES} for name, row in result["meshes"].items()}
    return json.dumps(result | {"meshes": meshes}, indent=indent)


def document(table: Table, result: Result, plots: list[str]) -> str:
    """The Markdown page of a result."""
    parts = [f"# {table.title}"]
    if result["meshes"]:
        parts += [table.text(result), *(f"![{table.title}]({plot})" for plot in plots)]
    parts += [f"Left out: {why}." for why in result["left_out"].values()]
    parts += [f"Failed: {name}: {why}." for name, why in result["failed"].items()]
    quick = " A quick run: too few rounds for the figures to mean much." if result["quick"] else ""
    parts.append(f"Measured on {sentence(result['machine'])}{quick}")
    return "\n\n".join(parts) + "\n"


def write(table: Table, result: Result, folder: Path) -> None:
    """NAME.json, NAME.md and the plots."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / f"{table.name}.json").write_text(as_json(result, indent=1) + "\n")
    (folder / f"{table.name}.md").write_text(document(table, result, _plots(table, result, folder)))


def _plots(table: Table, result: Result, folder: Path) -> list[str]:
    if table.plot is None or not result["meshes"]:
        return []
    if importlib.util.find_spec("matplotlib") is None:
        say("  no plots: matplotlib is not installed")
        return []
    return table.plot(result, folder)


def main(table: Table, arguments: list[str] | None = None) -> None:
    """The program of a table."""
    parser = argparse.ArgumentParser(description=table.title)
    parser.add_argument("meshes", nargs="*", default=list(table.meshes), help=f"files or names; {', '.join(table.meshes)} if not given")
    parser.add_argument("--quick", action="store_true", help="few rounds, to see that it runs")
    parser.add_argument("--json", action="store_true", help="print one JSON object instead of the page")
    parser.add_argument("--out", type=Path, help="folder for JSON, page and plots")
    options = parser.parse_args(arguments)
    result = make(table, options.meshes, options.quick)
    if options.out:
        write(table, result, options.out)
    print(as_json(result) if options.json else document(table, result, []))
    raise SystemExit(1 if result["failed"] else 0)


def say(text: str) -> None:
    """One line of progress."""
    print(text, file=sys.stderr, flush=True)
