"""What commands print: answers to stdout, all else to stderr, so that commands can be piped."""

from __future__ import annotations

import sys
from pathlib import Path

from rich.console import Console

from schemas.mesh import MeshInfo

out = Console()
err = Console(stderr=True)


def escaped(text: str) -> str:
    """Text in which rich finds no markup."""
    return text.replace("[", r"\[")


def write(path: Path, body: bytes, said: str) -> None:
    """Write a file and say so with a remark, or the bytes alone to stdout for the path -. Raises OSError."""
    if str(path) == "-":
        sys.stdout.buffer.write(body)
        sys.stdout.buffer.flush()
        return
    path.write_bytes(body)
    err.print(f"[green]{path}[/]  {said}", highlight=False, soft_wrap=True)


def print_json(mesh: MeshInfo) -> None:
    """One mesh as one line of JSON."""
    print(mesh.model_dump_json(exclude_none=True))
