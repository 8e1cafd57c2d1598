"""The `silhouette` command: what it can do, and how it fails."""

from __future__ import annotations

import sys
from collections.abc import Callable
from typing import NoReturn

import typer

from client.commands import access
from client.commands.accuracy import accuracy
from client.commands.console import err, escaped
from client.commands.meshes import delete, hull, info, list_meshes, original, upload
from client.commands.pictures import render, silhouette
from client.commands.running import demo, doctor, serve, worker
from client.commands.scenes import scene
from client.commands.sequences import frames, turntable
from client.errors import RequestError, ServiceError
from client.local import LocalServiceError

app = typer.Typer(
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode="markdown",
    pretty_exceptions_enable=False,
    help="Upload a heavy mesh once; from then on get any view in milliseconds, with exactly the original's outline.\n\n"
    "Begin with `silhouette demo`, or with `silhouette serve` in one terminal and `silhouette upload FILE` in another.",
)

COMMANDS: dict[str, Callable[..., None]] = {
    "serve": serve,
    "worker": worker,
    "demo": demo,
    "doctor": doctor,
    "upload": upload,
    "render": render,
    "turntable": turntable,
    "frames": frames,
    "scene": scene,
    "silhouette": silhouette,
    "accuracy": accuracy,
    "hull": hull,
    "original": original,
    "list": list_meshes,
    "info": info,
    "delete": delete,
    "sign": access.sign,
}
"""Every command, in the order of the help."""
for name, command in COMMANDS.items():
    app.command(name)(command)
app.add_typer(access.keys, name="keys")


def main() -> None:
    """Entry point: faults become one red line and exit code 1."""
    try:
        app()
    except RequestError as error:
        fields = [f"{item['field']}: {item['message']}" for item in error.fields]
        _fail("; ".join(fields) or str(error))
    except (ServiceError, LocalServiceError, TimeoutError, ValueError) as error:
        _fail(str(error))
    except OSError as error:
        _fail(f"{error.filename or 'file'}: {error.strerror or error}")


def _fail(message: str) -> NoReturn:
    err.print(f"[bold red]error[/] {escaped(message)}", highlight=False, soft_wrap=True)
    sys.exit(1)


if __name__ == "__main__":
    main()
