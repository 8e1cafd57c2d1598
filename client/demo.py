"""`silhouette demo`: the whole product once, on this machine, with nothing left running."""

from __future__ import annotations

import json
import signal
import statistics
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import FrameType
from typing import Any

from rich.console import Console
from rich.table import Table

from client.api import Client
from client.local import LocalService
from client.progress import upload_and_wait
from schemas.mesh import MeshInfo, StageStatus

SIZE = 512
AZIMUTHS_DEG = range(0, 360, 30)
PORTRAIT: dict[str, Any] = {"camera": {"orbit": {"azimuth_deg": 30.0, "elevation_deg": 20.0}}, "width": SIZE, "height": SIZE}

WAYS = {
    "original mesh": {"source": "original", "antialias": "none"},
    "original mesh, MSAA": {"source": "original", "antialias": "msaa"},
    "clipped hull, coverage": {"source": "clipped", "antialias": "coverage"},
}
"""What is compared: the mesh as a graphics library would draw it, and this service's own way."""

TABLE: dict[str, Any] = {"title_justify": "left", "box": None, "header_style": "dim", "padding": (0, 2)}

BASELINE = "original mesh, MSAA"

UNMEASURED = {"SILHOUETTE_MEASURE": "false"}
"""The frames are timed here: nothing else is to run beside them."""


@dataclass(frozen=True)
class Frames:
    """Medians over the views, milliseconds: from camera to pixels in the service, and from request to PNG in the client."""

    frame_ms: float
    trip_ms: float


def run_demo(mesh_path: Path | None, folder: Path, console: Console) -> None:
    """Upload, preprocess, render and measure; writes `folder/NAME.png`, `.svg` and `.json`.

    Raises ServiceError, LocalServiceError and OSError; stops what it started in every case.
    """
    with _ended_by_sigterm(), tempfile.TemporaryDirectory(prefix="silhouette-demo-") as scratch:
        path = mesh_path or _knot(Path(scratch), console)
        size = path.stat().st_size  # before a service is started for a file that is not there
        console.print(f"[bold]Silhouette Service[/]  {path.name}, {size / 2**20:.1f} MiB")
        began = time.perf_counter()
        with LocalService(Path(scratch) / "data", UNMEASURED) as service, Client(service.url, timeout_s=120.0) as client:
            console.print(f"service ready after {time.perf_counter() - began:.1f} s at {service.url}\n", highlight=False)
            mesh = upload_and_wait(client, path, console)
            silhouette = _write_results(client, mesh, folder, path.stem, console)
            ways = WAYS if mesh.capabilities.get("clip") is None or mesh.capabilities["clip"].available else _without_clip(mesh, console)
            measured = {name: _measure(client, mesh.id, accuracy) for name, accuracy in ways.items()}
        _tell(mesh, silhouette, measured, console)


def _knot(folder: Path, console: Console) -> Path:
    from client.shapes import torus_knot, write_ply

    with console.status("generating a torus knot of 185,856 faces"):
        path = folder / "knot.ply"
        write_ply(str(path), *torus_knot())
    return path


def _without_clip(mesh: MeshInfo, console: Console) -> dict[str, dict[str, str]]:
    console.print(f"[yellow]drawn from the original[/]: {mesh.capabilities['clip'].reason}\n", highlight=False)
    return {name: accuracy for name, accuracy in WAYS.items() if accuracy["source"] == "original"}


def _write_results(client: Client, mesh: MeshInfo, folder: Path, name: str, console: Console) -> dict[str, Any] | None:
    """Picture, drawing and data of one view; the silhouette, or None where the mesh has none."""
    folder.mkdir(parents=True, exist_ok=True)
    files = {".png": client.render(mesh.id, **PORTRAIT, background="transparent")}
    silhouette: dict[str, Any] | None = None
    view: dict[str, Any] = {"camera": PORTRAIT["camera"], "project": {"width": SIZE, "height": SIZE}}
    capability = mesh.capabilities.get("silhouette") or mesh.capabilities.get("clip")
    if capability is None or capability.available:
        files[".svg"] = client.silhouette_document(mesh.id, "svg", **view)
        files[".json"] = client.silhouette_document(mesh.id, "json", **view)
        silhouette = json.loads(files[".json"])
    console.print()
    for suffix, body in files.items():
        path = folder / f"{name}{suffix}"
        path.write_bytes(body)
        console.print(f"[green]wrote[/] {path}  [dim]{len(body) / 1024:,.0f} KiB", highlight=False)
    return silhouette


def _measure(client: Client, mesh_id: str, accuracy: dict[str, str]) -> Frames:
    """Medians over a turn about the mesh, after one frame that is not counted."""
    frame_ms, trip_ms = [], []
    for azimuth in (AZIMUTHS_DEG[0], *AZIMUTHS_DEG):
        camera = {"orbit": {"azimuth_deg": float(azimuth), "elevation_deg": 20.0}}
        began = time.perf_counter()
        picture = client.picture(mesh_id, camera=camera, width=SIZE, height=SIZE, accuracy=accuracy)
        trip_ms.append((time.perf_counter() - began) * 1e3)
        frame_ms.append(picture.frame_ms)
    return Frames(statistics.median(frame_ms[1:]), statistics.median(trip_ms[1:]))


def _tell(mesh: MeshInfo, silhouette: dict[str, Any] | None, measured: dict[str, Frames], console: Console) -> None:
    stages = Table("stage", "seconds", title="preprocessing, once", **TABLE)
    stages.columns[1].justify = "right"
    for stage in mesh.stages:
        skipped = stage.status is StageStatus.SKIPPED or stage.seconds is None
        stages.add_row(stage.name, "[dim]skipped" if skipped else f"{stage.seconds:.2f}")
    title = f"one frame of {SIZE}x{SIZE}, milliseconds, median of {len(AZIMUTHS_DEG)} views"
    frames = Table("drawn", "in the service", "round trip, PNG", "against MSAA", title=title, **TABLE)
    for column in frames.columns[1:]:
        column.justify = "right"
    for name, frame in measured.items():
        factor = measured[BASELINE].frame_ms / max(frame.frame_ms, 1e-9)
        best = name not in ("original mesh", BASELINE)
        style = "bold green" if best else ""
        frames.add_row(name, f"{frame.frame_ms:.1f}", f"{frame.trip_ms:.1f}", f"{factor:.1f}x faster" if best else "", style=style)
    console.print()
    console.print(stages)
    console.print()
    console.print(frames)
    console.print(f"\n{_edges(mesh, silhouette)}", highlight=False)


def _edges(mesh: MeshInfo, silhouette: dict[str, Any] | None) -> str:
    parts = []
    if mesh.stats:
        parts.append(f"{mesh.stats.faces:,} faces, {mesh.stats.edges:,} edges")
    if mesh.hull:
        parts.append(f"hull of {mesh.hull.faces:,} faces, {mesh.hull.volume_excess:.1%} more volume")
    if silhouette is not None:
        count = silhouette["edge_count"]
        share = f" ({count / mesh.stats.edges:.2%})" if mesh.stats else ""
        parts.append(f"{count:,} silhouette edges{share} in {len(silhouette.get('contours') or []):,} contours")
    return "\n".join(parts)


@contextmanager
def _ended_by_sigterm() -> Iterator[None]:
    """SIGTERM inside ends like Ctrl-C: by way of every `finally`."""

    def end(number: int, frame: FrameType | None) -> None:
        raise KeyboardInterrupt

    before = signal.signal(signal.SIGTERM, end)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)
