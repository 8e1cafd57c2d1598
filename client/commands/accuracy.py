"""What accuracy costs: the measured ladder of a mesh as a table, a plot or JSON."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from rich.table import Column, Table

from client.api import DEFAULT_URL
from client.commands.choosing import Key, MeshArgument, Url, chosen
from client.commands.console import escaped, out, write
from schemas.ladder import AccuracyReport
from schemas.render import Antialias, Source

COLUMNS = ("best", "ms", "error", "bound", "dB", "drawn", "level", "faces", "texels")
"""error: mean of alpha's; bound: certified, pixels; dB: PSNR of shading; level: that the outline is of; faces and texels are of the
hull and its maps."""
WORDS = ("best", "drawn")


def accuracy(
    mesh: MeshArgument,
    *,
    size: Annotated[int | None, typer.Option(min=1, help="Pixels a side of the pictures: the nearest measured size.")] = None,
    device: Annotated[str | None, typer.Option(help="Renderer that the times are of; without, the one that was measured on.")] = None,
    everything: Annotated[
        bool, typer.Option("--all", help="All rungs, not only the best for their time and what each antialias draws by itself.")
    ] = False,
    output: Annotated[Path | None, typer.Option("--output", "-o", help="Write the plot here, as SVG.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON for programs.")] = False,
    url: Url = DEFAULT_URL,
    key: Key = None,
) -> None:
    """Say what accuracy costs: the error and the time of every way a mesh can be drawn.

    `silhouette accuracy bunny.ply`

    `silhouette accuracy 3f2a91 --size 256 --all` or `silhouette accuracy 3f2a91 -o accuracy.svg`
    """
    with chosen(url, mesh, key) as (client, mesh_id):
        report = client.accuracy(mesh_id, size, device)
        plot = None if output is None else client.accuracy_plot(mesh_id, size, device)
    if output is not None and plot is not None:
        write(output, plot, f"{len(report.rungs)} rungs")
    elif as_json:
        print(report.model_dump_json(exclude_none=True))
    else:
        _print(report, everything)


def _print(report: AccuracyReport, everything: bool) -> None:
    shown = set(range(len(report.rungs))) if everything else {*report.pareto.outline, *report.pareto.shading, *_defaults(report)}
    left = "" if everything else f", {len(report.rungs) - len(shown)} more with --all"
    table = Table(*(Column(name, justify="left" if name in WORDS else "right", no_wrap=True) for name in COLUMNS), box=None)
    for number in sorted(shown, key=lambda n: report.rungs[n].ms):
        table.add_row(*_row(report, number))
    measured = "measured" if any(rung.ms_p95 is not None for rung in report.rungs) else "predicted"
    size = f"{report.size} x {report.size} px, {report.views} views"
    out.print(f"[bold]{escaped(report.name)}[/], {size}, times {measured} on {escaped(report.device)}", highlight=False, soft_wrap=True)
    out.print(table)
    told = f"best: in no more time there is no better outline, shading, or both{left}"
    out.print(told, style="dim", highlight=False, soft_wrap=True)


def _row(report: AccuracyReport, number: int) -> tuple[str, ...]:
    rung, outline, shading = report.rungs[number], number in report.pareto.outline, number in report.pareto.shading
    best = "both" if outline and shading else "outline" if outline else "shading" if shading else ""
    return (
        f"[green]{best}",
        f"{rung.ms:.2f}",
        f"{rung.alpha_error:.4f}",
        "-" if rung.bound_px is None else f"{rung.bound_px:.3g}",
        f"{rung.psnr_db:.1f}",
        f"{rung.source.value}/{rung.antialias.value}",
        *("-" if part is None else f"{part}" for part in (rung.level, rung.hull_faces, rung.texels)),
    )


def _defaults(report: AccuracyReport) -> list[int]:
    """The first rung of each source and antialias, with the mesh's own outline: what a request that names only these draws."""
    first: dict[tuple[Source, Antialias], int] = {}
    for number, rung in enumerate(report.rungs):
        if rung.level is None:
            first.setdefault((rung.source, rung.antialias), number)
    return list(first.values())
