"""What accuracy costs: the measured ladder of a mesh as a table, a plot or JSON."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from rich.table import Column, Table

from client.api import DEFAULT_URL
from client.commands.choosing import MeshArgument, Url, chosen
from client.commands.console import escaped, out, write
from schemas.ladder import AccuracyReport, AccuracyRung

OUTLINE_MARK, SHADING_MARK = "o", "s"
"""Rungs of the fronts: no other one beats their outline, or their shading, in as little time."""


def accuracy(
    mesh: MeshArgument,
    *,
    size: Annotated[int | None, typer.Option(min=1, help="Pixels a side of the pictures: the nearest measured size.")] = None,
    device: Annotated[str | None, typer.Option(help="Renderer that the times are of; without, the one that was measured on.")] = None,
    everything: Annotated[bool, typer.Option("--all", help="All rungs, not only those that are worth having.")] = False,
    output: Annotated[Path | None, typer.Option("--output", "-o", help="Write the plot here, as SVG.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON for programs.")] = False,
    url: Url = DEFAULT_URL,
) -> None:
    """Say what accuracy costs: the error and the time of every way a mesh can be drawn.

    `silhouette accuracy bunny.ply`

    `silhouette accuracy 3f2a91 --size 256 --all` or `silhouette accuracy 3f2a91 -o accuracy.svg`
    """
    with chosen(url, mesh) as (client, mesh_id):
        report = client.accuracy(mesh_id, size, device)
        plot = None if output is None else client.accuracy_plot(mesh_id, size, device)
    if output is not None and plot is not None:
        write(output, plot, f"{len(report.rungs)} rungs")
    elif as_json:
        print(report.model_dump_json(exclude_none=True))
    else:
        _print(report, everything)


def _print(report: AccuracyReport, everything: bool) -> None:
    fronts = {number for best in (report.pareto.outline, report.pareto.shading) for number in best}
    shown = [n for n in range(len(report.rungs)) if everything or n in fronts]
    shown.sort(key=lambda n: report.rungs[n].ms)
    table = Table(
        Column("", width=2, no_wrap=True),
        Column("ms", justify="right", no_wrap=True),
        Column("alpha error", justify="right", no_wrap=True),
        Column("bound px", justify="right", no_wrap=True),
        Column("PSNR dB", justify="right", no_wrap=True),
        Column("rung", overflow="fold"),
        box=None,
        header_style="bold",
    )
    for number in shown:
        rung = report.rungs[number]
        marks = (OUTLINE_MARK if number in report.pareto.outline else "") + (SHADING_MARK if number in report.pareto.shading else "")
        bound = "-" if rung.bound_px is None else f"{rung.bound_px:.3g}"
        table.add_row(f"[green]{marks}", f"{rung.ms:.2f}", f"{rung.alpha_error:.4f}", bound, f"{rung.psnr_db:.1f}", _named(rung))
    out.print(
        f"[bold]{escaped(report.name)}[/], {report.size} x {report.size} px, {report.views} views, on {escaped(report.device)}",
        highlight=False,
    )
    out.print(table)
    left = "" if everything else f"; {len(report.rungs) - len(shown)} more with --all"
    out.print(
        f"{OUTLINE_MARK}: no faster outline is as exact, {SHADING_MARK}: no faster shading is as exact{left}", style="dim", highlight=False
    )


def _named(rung: AccuracyRung) -> str:
    return escaped(rung.name)
