"""How every benchmark reads its arguments and prints its result: a table, or one JSON object with --json."""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable
from typing import Any

from benchmarks.models import MESH_HELP, AbsentError

Result = dict[str, Any]


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
