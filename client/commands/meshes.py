"""Commands about what the service keeps: upload, list, info, delete."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import orjson
import typer
from rich.table import Column, Table

from client.api import DEFAULT_URL, Client
from client.commands.choosing import IdArgument, Key, Url, chosen
from client.commands.console import err, escaped, out, print_json, write
from client.commands.viewing import by_suffix
from client.progress import upload_and_wait
from schemas.artifacts import ORIGINAL_GLB
from schemas.mesh import DEFAULT_HULL_FACES, DEFAULT_TEXELS, MeshInfo

AsJson = Annotated[bool, typer.Option("--json", help="Print JSON for programs.")]


def upload(
    file: Annotated[Path, typer.Argument(exists=True, dir_okay=False, help="STL, OBJ, PLY, OFF, GLB or 3MF.")],
    hull_faces: Annotated[int, typer.Option(help="Faces of the coarse hull that is drawn.")] = DEFAULT_HULL_FACES,
    texels: Annotated[int, typer.Option(help="Longest side of the normal and colour maps.")] = DEFAULT_TEXELS,
    no_repair: Annotated[bool, typer.Option("--no-repair", help="Take the mesh as it is: close no holes, turn no faces.")] = False,
    no_wait: Annotated[bool, typer.Option("--no-wait", help="Return when the service has the bytes.")] = False,
    as_json: AsJson = False,
    url: Url = DEFAULT_URL,
    key: Key = None,
) -> None:
    """Upload a mesh, wait until it is ready, and print its id.

    `silhouette upload bunny.ply` or `ID=$(silhouette upload bunny.ply --hull-faces 500)`
    """
    options: dict[str, Any] = {"hull_faces": hull_faces, "texels": texels, "repair": "never" if no_repair else "auto"}
    with Client(url, key=key) as client:
        mesh = client.upload(file, **options) if no_wait else upload_and_wait(client, file, err, **options)
    print_json(mesh) if as_json else print(mesh.id)


def list_meshes(
    limit: Annotated[int, typer.Option(min=1, help="At most so many, newest first.")] = 50,
    as_json: AsJson = False,
    url: Url = DEFAULT_URL,
    key: Key = None,
) -> None:
    """List the meshes of the service, newest first.

    `silhouette list` or `silhouette list --json | jq -r '.[].id'`
    """
    with Client(url, key=key) as client:
        meshes = list(client.list(limit))
    if as_json:
        print(orjson.dumps([mesh.model_dump(mode="json", exclude_none=True) for mesh in meshes]).decode())
        return
    table = Table(
        Column("id", no_wrap=True, min_width=32),
        "name",
        "status",
        "faces",
        "hull",
        Column("created", min_width=10),
        box=None,
        header_style="bold",
    )
    for mesh in meshes:
        faces = f"{mesh.stats.faces:,}" if mesh.stats else ""
        hull = f"{mesh.hull.faces:,}" if mesh.hull else ""
        color = {"ready": "green", "failed": "red"}.get(mesh.status, "yellow")
        table.add_row(mesh.id, mesh.name, f"[{color}]{mesh.status}", faces, hull, f"{mesh.created:%Y-%m-%d %H:%M}")
    out.print(table if meshes else "No meshes yet. Upload one: silhouette upload FILE")


def info(mesh: IdArgument, as_json: AsJson = False, url: Url = DEFAULT_URL, key: Key = None) -> None:
    """Say everything about a mesh: stages, measured facts, what it can do and what was repaired.

    `silhouette info 3f2a91`
    """
    with chosen(url, mesh, key) as (client, mesh_id):
        found = client.info(mesh_id)
    if as_json:
        print_json(found)
        return
    table = Table(box=None, show_header=False)
    for name, value in _facts(found):
        table.add_row(f"[dim]{name}", value)
    out.print(table)


def delete(mesh: IdArgument, url: Url = DEFAULT_URL, key: Key = None) -> None:
    """Remove a mesh and everything made from it; what is being done for it is cancelled.

    `silhouette delete 3f2a91`
    """
    with chosen(url, mesh, key) as (client, mesh_id):
        client.delete(mesh_id)


def hull(
    mesh: IdArgument,
    output: Annotated[Path, typer.Option("--output", "-o", help="File to write: .glb; - for stdout.")],
    faces: Annotated[int | None, typer.Option(min=4, help="At most so many faces; as many as the drawn hull if not given.")] = None,
    inner: Annotated[bool, typer.Option("--inner", help="A hull that the mesh encloses, instead of one that encloses it.")] = False,
    url: Url = DEFAULT_URL,
    key: Key = None,
) -> None:
    """Write a hull of a mesh, of any size, as binary glTF.

    `silhouette hull 3f2a91 -o hull.glb --faces 500` or `silhouette hull 3f2a91 -o inside.glb --inner`
    """
    with chosen(url, mesh, key) as (client, mesh_id):
        body = client.hull(mesh_id, faces, "inner" if inner else "outer")
    write(output, body, f"{len(body) / 1024:.1f} KiB")


def original(
    mesh: IdArgument,
    output: Annotated[Path, typer.Option("--output", "-o", help="File to write: .glb, or .npy for the vertices; - for GLB to stdout.")],
    url: Url = DEFAULT_URL,
    key: Key = None,
) -> None:
    """Write a mesh as the service has it: the vertices that `--positions` moves, in their order, and its faces.

    `silhouette original 3f2a91 -o rest.npy`, then move what it holds and `silhouette frames 3f2a91 --positions moved.npy -o moved.webp`
    """
    as_array = by_suffix(output, {".glb": False, ".npy": True}, False)
    with chosen(url, mesh, key) as (client, mesh_id):
        body = client.download(mesh_id, ORIGINAL_GLB)
    if as_array:
        from client.positions import opened, original_of

        with opened(original_of(body).positions) as array_file:
            body = array_file.read()
    write(output, body, f"{len(body) / 1024:.1f} KiB")


def _facts(mesh: MeshInfo) -> list[tuple[str, str]]:
    facts = [("id", mesh.id), ("name", mesh.name), ("status", str(mesh.status)), ("created", f"{mesh.created:%Y-%m-%d %H:%M:%S}")]
    if mesh.error:
        facts.append(("error", f"[red]{escaped(mesh.error.detail)}"))
    if mesh.stats:
        facts += [(name, _plain(value)) for name, value in mesh.stats if name != "bounds"]
        facts.append(("bounds", " to ".join("({})".format(", ".join(f"{x:.6g}" for x in corner)) for corner in mesh.stats.bounds)))
    if mesh.hull:
        facts.append(("hull", f"{mesh.hull.faces:,} faces, {mesh.hull.volume_excess:.1%} more volume"))
        facts += [
            (f"{level.side} hull", f"{level.faces:,} faces, {level.volume_excess:+.1%} volume, at most {level.distance:.4g} away")
            for level in mesh.hull.levels
        ]
    for name, capability in mesh.capabilities.items():
        facts.append((name, "yes" if capability.available else f"no: {capability.reason}"))
    facts += [(f"stage {s.name}", f"{s.status} {'' if s.seconds is None else f'{s.seconds:.2f} s'}") for s in mesh.stages]
    return facts + [(name.replace("_", " "), _plain(value)) for name, value in (mesh.repairs or {}).items() if value]


def _plain(value: object) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    return f"{value:,}" if isinstance(value, int) else str(value)
