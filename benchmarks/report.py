"""How benchmarks read their arguments and say their results: tables, figures of text, and one JSON object with --json."""

from __future__ import annotations

import argparse
import json
import math
from collections.abc import Callable, Sequence
from typing import Any

from benchmarks.models import MESH_HELP, AbsentError

Result = dict[str, Any]

NONE = "–"
"""What a cell without a value says."""


def mesh_parser(documentation: str) -> argparse.ArgumentParser:
    """A parser with a mesh and --json; `documentation` is the module's."""
    parser = argparse.ArgumentParser(description=documentation, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("mesh", help=MESH_HELP)
    parser.add_argument("--json", action="store_true", help="one JSON object instead of a table")
    return parser


def report(make: Callable[[], Result], as_json: bool, print_table: Callable[[Result], None]) -> None:
    """Make the result and print it; a mesh that is absent ends the program with a sentence."""
    try:
        result = make()
    except AbsentError as absent:
        raise SystemExit(str(absent)) from None
    if as_json:
        print(json.dumps(result))
    else:
        print_table(result)


def number(value: float | None, digits: int = 3) -> str:
    """A number with so many significant digits, whole numbers with all of theirs and commas; NONE for None."""
    if value is None or not math.isfinite(value):
        return NONE
    if isinstance(value, int):
        return f"{value:,}"
    if value == 0:
        return "0"
    decimals = digits - 1 - math.floor(math.log10(abs(float(f"{value:.{digits - 1}e}"))))
    return f"{value:,.{max(decimals, 0)}f}"


def times(value: float | None) -> str:
    """A ratio: 4.1 x."""
    return NONE if value is None else f"{number(value, 2 if value < 10 else 3)} x"


def ratio(slow: float | None, fast: float | None) -> float | None:
    """slow / fast; None where one of them is missing."""
    return None if slow is None or not fast else slow / fast


def markdown_table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A Markdown table, its first column to the left and the others to the right."""
    for row in rows:
        if len(row) != len(head):
            raise ValueError(f"a row has {len(row)} cells under {len(head)} titles: {row}")
    lines = [head, ["---", *("---:" for _ in head[1:])], *rows]
    return "\n".join("| " + " | ".join(cell.replace("|", "\\|").replace("\n", " ") for cell in line) + " |" for line in lines)
