"""`python -m service.doctor`: all checks, as a table for people or as JSON; the exit status is 1 when the service would not work."""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path

from pydantic import ValidationError
from rich.console import Console
from rich.table import Column, Table
from rich.text import Text

from backend.logs import configure_logs
from backend.settings import setting_faults
from service.doctor import backend, machine
from service.doctor.finding import Check, Finding
from service.settings import ServiceSettings

CHECKS: dict[str, Check] = {
    "python": machine.check_python,
    "kernel cache": machine.check_kernel_cache,
    "open files": machine.check_files,
    "clock": machine.check_clock,
    "queue": backend.check_queue,
    "store": backend.check_store,
    "keys": backend.check_access,
    "port": backend.check_port,
    "drawing": machine.check_drawing,
}
"""In the order of the table. Drawing is last: a process with a GL context must not fork."""

COLORS = {"ok": "green", "warning": "yellow", "failed": "bold red"}


def main() -> int:
    """Run the checks and print them; the exit status: 2 for settings that cannot be used."""
    parser = argparse.ArgumentParser(prog="python -m service.doctor", description="Check this machine and the settings.")
    parser.add_argument("--json", action="store_true", help="print JSON for programs")
    parser.add_argument("--host", help="address that is to be listened on")
    parser.add_argument("--port", type=int, help="port that is to be listened on")
    parser.add_argument("--data-dir", type=Path, help="folder of everything that is kept")
    flags = vars(parser.parse_args())
    as_json = flags.pop("json")
    try:
        settings = ServiceSettings(**{name: value for name, value in flags.items() if value is not None})
    except ValidationError as error:
        print(*setting_faults(error), sep="\n", file=sys.stderr)
        return 2
    configure_logs("doctor", "ERROR")
    findings = {name: examined(check, settings) for name, check in CHECKS.items()}
    print_json(findings) if as_json else print_table(findings)
    return int(any(found.state == "failed" for found in findings.values()))


def examined(check: Check, settings: ServiceSettings) -> Finding:
    """What a check found; what it did not expect is a failure of the thing, not of the doctor."""
    try:
        return check(settings)
    except Exception as error:
        return Finding(f"{type(error).__name__}: {error}", "this was not foreseen: see the message")


def print_json(findings: dict[str, Finding]) -> None:
    """One object: `ok`, and of each check its state, what was found and the fix."""
    checks = [{"name": name, "state": one.state, "found": one.found, "fix": one.fix} for name, one in findings.items()]
    print(json.dumps({"ok": all(one.state != "failed" for one in findings.values()), "checks": checks}))


def print_table(findings: dict[str, Finding]) -> None:
    """A line a check, and below it how to mend what is wrong."""
    table = Table(
        Column("check", no_wrap=True), Column("state", no_wrap=True), Column("found", overflow="fold"), box=None, header_style="bold"
    )
    for name, one in findings.items():
        told = Text(one.found)
        if one.fix is not None:
            told.append(f"\nfix: {one.fix}", style="bold")
        table.add_row(name, Text(one.state, COLORS[one.state]), told)
    Console().print(table)


if __name__ == "__main__":
    sys.exit(main())
