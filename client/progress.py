"""Progress of a mesh in the terminal: one bar for the upload, one a stage; plain lines where there is no terminal."""

from __future__ import annotations

from pathlib import Path
from types import TracebackType
from typing import Any, Self

from rich.console import Console
from rich.progress import BarColumn, Progress, ProgressColumn, SpinnerColumn, Task, TaskID, TextColumn
from rich.text import Text

from client.api import Client
from schemas.jobs import STAGES
from schemas.mesh import MeshInfo, Stage, StageStatus

ENDED = {StageStatus.DONE: "green", StageStatus.SKIPPED: "dim", StageStatus.FAILED: "red"}


def upload_and_wait(client: Client, path: Path, console: Console, **options: Any) -> MeshInfo:
    """Upload a file and return when it is ready, showing how far it is. Raises ServiceError, OSError."""
    with MeshProgress(console) as progress:
        mesh = client.upload(path, on_progress=progress.upload, **options)
        return client.wait(mesh.id, on_progress=progress.mesh)


class MeshProgress:
    """Shows what `Client.upload` and `Client.wait` report."""

    def __init__(self, console: Console) -> None:
        self._console = console
        columns: list[ProgressColumn] = [
            SpinnerColumn(finished_text="[green]✓"),
            TextColumn("{task.description:8}"),
            BarColumn(bar_width=36),
            _Said(),
        ]
        self._bars = Progress(*columns, console=console, disable=not console.is_terminal)
        self._tasks: dict[str, TaskID] = {}
        self._told: set[str] = set()

    def __enter__(self) -> Self:
        self._bars.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self._bars.stop()

    def upload(self, sent: int, total: int) -> None:
        """Bytes on their way."""
        self._show("upload", sent / max(total, 1), f"{total / 2**20:.1f} MiB", sent == total)

    def mesh(self, info: MeshInfo) -> None:
        """Stages until the mesh is ready; nobody waits for what comes later."""
        for stage in (stage for stage in info.stages if stage.name in STAGES):
            ended = stage.status in ENDED
            self._show(stage.name, stage.progress, _said(stage), ended)

    def _show(self, name: str, fraction: float, said: str, ended: bool) -> None:
        if not self._bars.disable:
            task = self._tasks.get(name)
            if task is None:
                task = self._tasks[name] = self._bars.add_task(name, total=1.0, said="")
            self._bars.update(task, completed=1.0 if ended else min(fraction, 0.999), said=said)
        elif ended and name not in self._told:
            self._told.add(name)
            self._console.print(f"{name:8} {said}", markup=True, highlight=False)


class _Said(ProgressColumn):
    def render(self, task: Task) -> Text:
        """The text that came with the last report."""
        return Text.from_markup(str(task.fields.get("said", "")))


def _said(stage: Stage) -> str:
    if stage.status is StageStatus.RUNNING:
        return f"{stage.progress:.0%}"
    if stage.status not in ENDED:
        return "[dim]waits"
    color = ENDED[stage.status]
    seconds = "" if stage.seconds is None or stage.status is StageStatus.SKIPPED else f"{stage.seconds:6.2f} s "
    return f"[{color}]{seconds}{'' if stage.status is StageStatus.DONE else stage.status}"
