"""Which service and which mesh a command is about."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import typer

from client.api import Client
from client.commands.console import err
from client.progress import upload_and_wait

MESH_ID = re.compile(r"[0-9a-f]{4,32}")

Url = Annotated[str, typer.Option("--url", envvar="SILHOUETTE_URL", help="Address of the service.")]
Key = Annotated[str | None, typer.Option("--key", envvar="SILHOUETTE_API_KEY", help="API key, where the service asks for one.")]
MeshArgument = Annotated[
    str, typer.Argument(metavar="ID|FILE", help="A mesh id, the beginning of one, or a file, which is uploaded first.")
]
Once = Annotated[
    bool,
    typer.Option("--once", help="Draw a file that the service does not keep: nothing is prepared for the next time."),
]
IdArgument = Annotated[str, typer.Argument(metavar="ID", help="A mesh id or the beginning of one.")]


@contextmanager
def chosen(url: str, mesh: str, key: str | None = None) -> Iterator[tuple[Client, str]]:
    """A client of the service at `url` and the id that `mesh` means there. Raises ValueError when it means none."""
    with Client(url, key=key) as client:
        yield client, mesh_id(client, mesh)


@contextmanager
def unkept(url: str, mesh: str, key: str | None = None) -> Iterator[tuple[Client, Path]]:
    """A client of the service at `url` and the file that is to be drawn once. Raises ValueError when there is none."""
    if not Path(mesh).is_file():
        raise ValueError(f"--once draws a file, and {mesh} is none")
    with Client(url, key=key) as client:
        yield client, Path(mesh)


def mesh_id(client: Client, mesh: str) -> str:
    """The id meant: of a file that is uploaded first, or of the one mesh whose id begins so."""
    path = Path(mesh)
    if path.is_file():
        return upload_and_wait(client, path, err).id
    if len(mesh) == 32 or not MESH_ID.fullmatch(mesh):
        if not MESH_ID.fullmatch(mesh):
            raise ValueError(f"{mesh} is neither a file nor a mesh id; `silhouette list` shows the ids")
        return mesh
    found = [known.id for known in client.list() if known.id.startswith(mesh)]
    if len(found) != 1:
        raise ValueError(f"{'no mesh id begins' if not found else 'several mesh ids begin'} with {mesh}; `silhouette list` shows them")
    return found[0]
