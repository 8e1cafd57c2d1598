"""Commands that run the service or look whether it would run: serve, worker, demo, doctor."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import Annotated, NoReturn

import typer

from client.commands.console import out
from client.demo import run_demo


def serve(
    host: Annotated[str, typer.Option(help="Address to listen on; 0.0.0.0 for every network.")] = "127.0.0.1",
    port: Annotated[int, typer.Option(help="Port; 0 takes a free one.")] = 8000,
    data_dir: Annotated[Path | None, typer.Option(help="Folder of everything that is kept.")] = None,
    workers: Annotated[int | None, typer.Option(help="Worker processes; as many as processors if not given.")] = None,
    processes: Annotated[
        int | None, typer.Option(help="Service processes behind the port, each with a renderer of its own; 1 if not given.")
    ] = None,
    insecure: Annotated[bool, typer.Option("--insecure", help="Listen for other machines though there is no key.")] = False,
) -> None:
    """Run the service: API, web page, queue and workers on this machine.

    With SILHOUETTE_REDIS_URL set it uses that Redis and starts neither queue nor workers.

    For other machines it needs a key first (`silhouette keys add`).

    `silhouette serve --port 8000 --data-dir ./data`
    """
    flags = {"--host": host, "--port": port, "--data-dir": data_dir, "--workers": workers, "--processes": processes}
    given = [text for flag, value in flags.items() if value is not None for text in (flag, str(value))]
    _become("service", [*given, *(["--insecure"] if insecure else [])])


def worker() -> None:
    """Run one more worker for a service that uses a Redis of its own.

    `SILHOUETTE_REDIS_URL=redis://host:6379/0 silhouette worker`
    """
    _become("worker", [])


def demo(
    mesh: Annotated[Path | None, typer.Argument(help="A mesh of your own; a torus knot of 185,856 faces if not given.")] = None,
    folder: Annotated[Path, typer.Option("--out", help="Where the picture and the silhouette go.")] = Path("demo"),
) -> None:
    """Show everything once: start a service, upload a mesh, render it, measure, and stop it all again.

    `silhouette demo` or `silhouette demo bunny.ply --out /tmp/bunny`
    """
    run_demo(mesh, folder, out)


def doctor(
    host: Annotated[str | None, typer.Option(help="Address that is to be listened on.")] = None,
    port: Annotated[int | None, typer.Option(help="Port that is to be listened on.")] = None,
    data_dir: Annotated[Path | None, typer.Option(help="Folder of everything that is kept.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON for programs.")] = False,
) -> None:
    """Check this machine and the settings: drawing, queue, store, limits, port; say how to mend what is wrong.

    Exit code 1 where the service would not work.

    `silhouette doctor` or `silhouette doctor --json | jq .ok`
    """
    flags = {"--host": host, "--port": port, "--data-dir": data_dir}
    given = [text for flag, value in flags.items() if value is not None for text in (flag, str(value))]
    _become("service.doctor", [*given, *(["--json"] if as_json else [])])


def _become(module: str, arguments: list[str]) -> NoReturn:
    """Turn this process into `python -m module`, so that signals and the exit status are its own."""
    sys.stdout.flush()
    os.execv(sys.executable, [sys.executable, "-m", module, *arguments])
