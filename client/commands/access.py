"""Commands about who may use a service: its keys, and addresses that work without one."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import orjson
import typer
from rich.table import Column, Table

from client.api import DEFAULT_URL, Client
from client.commands.choosing import Key, Url
from client.commands.console import err, escaped, out
from client.local import LocalKeys
from schemas.access import DEFAULT_SIGNED_S, KeyInfo, Scope

keys = typer.Typer(
    no_args_is_help=True,
    rich_markup_mode="markdown",
    help="API keys: make, list and revoke them.\n\n"
    "Without `--url` those of this machine's data folder, which is how the first is made: `silhouette keys add NAME --scope read`.\n\n"
    "With `--url` those of a running service, which asks for a key with the scope admin: "
    "`silhouette keys list --url https://silhouette.example`.",
)

There = Annotated[
    str | None,
    typer.Option("--url", envvar="SILHOUETTE_URL", help="Address of a running service; the data folder of this machine if not given."),
]
DataDir = Annotated[Path | None, typer.Option(help="Folder of everything that is kept; without --url.")]
KeyId = Annotated[str, typer.Argument(metavar="KEY", help="The id of a key, as `silhouette keys list` shows it.")]


@keys.command("add")
def add(  # noqa: PLR0913 - the options of a command are its language
    name: Annotated[str, typer.Argument(help="What the key is for, for people.")],
    *,
    scope: Annotated[list[Scope], typer.Option(help="What it may do: read, write, admin; may be given again.")],
    expires_in_days: Annotated[float | None, typer.Option(help="Days that it lasts; for ever if not given.")] = None,
    requests_per_minute: Annotated[int | None, typer.Option(help="Requests a minute.")] = None,
    concurrent_renders: Annotated[int | None, typer.Option(help="Pictures and silhouettes in work at once.")] = None,
    max_pixels: Annotated[int | None, typer.Option(help="Pixels of its largest picture.")] = None,
    max_faces: Annotated[int | None, typer.Option(help="Faces of its largest mesh.")] = None,
    max_upload_mib: Annotated[int | None, typer.Option(help="MiB of its largest upload.")] = None,
    data_dir: DataDir = None,
    url: There = None,
    key: Key = None,
) -> None:
    """Make a key and print it with its token, which is shown this once.

    `silhouette keys add "shop window" --scope read --requests-per-minute 600 | jq -r .token`
    """
    limits = {
        "requests_per_minute": requests_per_minute,
        "concurrent_renders": concurrent_renders,
        "max_pixels": max_pixels,
        "max_faces": max_faces,
        "max_upload_mib": max_upload_mib,
    }
    with _keys_at(url, key, data_dir) as place:
        made = place.add_key(name, scopes=scope, expires_in_days=expires_in_days, limits=limits)
    print(made.model_dump_json(exclude_none=True))


@keys.command("list")
def list_keys(
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON for programs.")] = False,
    data_dir: DataDir = None,
    url: There = None,
    key: Key = None,
) -> None:
    """List the keys, without their secrets.

    `silhouette keys list` or `silhouette keys list --json --url https://silhouette.example | jq -r '.[].id'`
    """
    with _keys_at(url, key, data_dir) as place:
        found = place.keys()
    if as_json:
        print(orjson.dumps([one.model_dump(mode="json", exclude_none=True) for one in found]).decode())
    elif found:
        out.print(_table(found))
    else:
        err.print("No keys yet. Make one: silhouette keys add NAME --scope read")


@keys.command("revoke")
def revoke(which: KeyId, data_dir: DataDir = None, url: There = None, key: Key = None) -> None:
    """Revoke a key, and with it every address that it signed; a running service forgets it within seconds.

    `silhouette keys revoke 9597ca773ce60be5`
    """
    with _keys_at(url, key, data_dir) as place:
        place.revoke_key(which)


def sign(
    address: Annotated[str, typer.Argument(help="What is to be seen, like /v1/meshes/ID/thumbnail.webp?size=256.")],
    expires: Annotated[int, typer.Option("--expires", min=1, help="Seconds from now until which it is good.")] = DEFAULT_SIGNED_S,
    url: Url = DEFAULT_URL,
    key: Key = None,
) -> None:
    """Print the address of a picture, drawing or download that works without a key for a while, for a page that everyone sees.

    `silhouette sign "/v1/meshes/3f2a917c5be04d1f8a6c0d9e2b7f4a11/render.png?azimuth=40" --expires 86400`
    """
    with Client(url, key=key) as client:
        print(client.sign(address, expires))


@contextmanager
def _keys_at(url: str | None, key: str | None, data_dir: Path | None) -> Iterator[Client | LocalKeys]:
    """The keys of a running service, or those of this machine's data folder."""
    if url is None:
        yield LocalKeys(data_dir)
        return
    with Client(url, key=key) as client:
        yield client


def _table(found: Sequence[KeyInfo]) -> Table:
    table = Table(Column("id", no_wrap=True), "name", "scopes", "expires", "limits", box=None, header_style="bold")
    for one in found:
        expires = "never" if one.expires is None else f"{one.expires:%Y-%m-%d %H:%M}"
        limits = ", ".join(f"{name} {value}" for name, value in one.limits if value is not None)
        table.add_row(one.id, escaped(one.name), " ".join(one.scopes), expires, limits)
    return table
