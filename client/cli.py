"""The `silhouette` command."""

from __future__ import annotations

import os
import re
import sys
from pathlib import Path
from typing import Annotated, Any, NoReturn

import orjson
import typer
from rich.console import Console
from rich.table import Column, Table

from client.api import DEFAULT_URL, Client
from client.demo import run_demo
from client.errors import RequestError, ServiceError
from client.local import LocalServiceError
from client.progress import upload_and_wait
from schemas.mesh import DEFAULT_HULL_FACES, DEFAULT_TEXELS, MeshInfo
from schemas.render import Antialias, ImageFormat, ShadingMode, Source

app = typer.Typer(
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode="markdown",
    pretty_exceptions_enable=False,
    help="Upload a heavy mesh once; from then on get any view in milliseconds, with exactly the original's outline.\n\n"
    "Begin with `silhouette demo`, or with `silhouette serve` in one terminal and `silhouette upload FILE` in another.",
)
out = Console()
err = Console(stderr=True)

MESH_ID = re.compile(r"[0-9a-f]{4,32}")
IMAGE_SUFFIXES = {
    ".png": ImageFormat.PNG,
    ".webp": ImageFormat.WEBP,
    ".jpg": ImageFormat.JPEG,
    ".jpeg": ImageFormat.JPEG,
    ".raw": ImageFormat.RAW,
}
SILHOUETTE_SUFFIXES = {".json": "json", ".svg": "svg", ".bin": "binary"}

Url = Annotated[str, typer.Option("--url", envvar="SILHOUETTE_URL", help="Address of the service.")]
MeshArgument = Annotated[
    str, typer.Argument(metavar="ID|FILE", help="A mesh id, the beginning of one, or a file, which is uploaded first.")
]
IdArgument = Annotated[str, typer.Argument(metavar="ID", help="A mesh id or the beginning of one.")]
Azimuth = Annotated[float, typer.Option(help="Degrees about +y, from +z.")]
Elevation = Annotated[float, typer.Option(help="Degrees towards +y, -90 to 90.")]
Eye = Annotated[str | None, typer.Option(metavar="X,Y,Z", help="Eye in model units, instead of azimuth and elevation.")]
Target = Annotated[str | None, typer.Option(metavar="X,Y,Z", help="What the eye looks at; the origin if not given.")]
Fov = Annotated[float, typer.Option(help="Vertical field of view, degrees.")]
Size = Annotated[str, typer.Option(metavar="WxH", help="Pixels, like 800x600, or one number for a square.")]
AsJson = Annotated[bool, typer.Option("--json", help="Print JSON for programs.")]


@app.command()
def serve(
    host: Annotated[str, typer.Option(help="Address to listen on; 0.0.0.0 for every network.")] = "127.0.0.1",
    port: Annotated[int, typer.Option(help="Port; 0 takes a free one.")] = 8000,
    data_dir: Annotated[Path | None, typer.Option(help="Folder of everything that is kept.")] = None,
    workers: Annotated[int | None, typer.Option(help="Worker processes; as many as processors if not given.")] = None,
) -> None:
    """Run the service: API, web page, queue and workers on this machine.

    With SILHOUETTE_REDIS_URL set it uses that Redis and starts neither queue nor workers.

    `silhouette serve --port 8000 --data-dir ./data`
    """
    flags = {"--host": host, "--port": port, "--data-dir": data_dir, "--workers": workers}
    _become("service", [text for flag, value in flags.items() if value is not None for text in (flag, str(value))])


@app.command()
def worker() -> None:
    """Run one more worker for a service that uses a Redis of its own.

    `SILHOUETTE_REDIS_URL=redis://host:6379/0 silhouette worker`
    """
    _become("worker", [])


@app.command()
def demo(
    mesh: Annotated[Path | None, typer.Argument(help="A mesh of your own; a torus knot of 185,856 faces if not given.")] = None,
    folder: Annotated[Path, typer.Option("--out", help="Where the picture and the silhouette go.")] = Path("demo"),
) -> None:
    """Show everything once: start a service, upload a mesh, render it, measure, and stop it all again.

    `silhouette demo` or `silhouette demo bunny.ply --out /tmp/bunny`
    """
    run_demo(mesh, folder, out)


@app.command()
def upload(
    file: Annotated[Path, typer.Argument(exists=True, dir_okay=False, help="STL, OBJ, PLY, OFF, GLB or 3MF.")],
    hull_faces: Annotated[int, typer.Option(help="Faces of the coarse hull that is drawn.")] = DEFAULT_HULL_FACES,
    texels: Annotated[int, typer.Option(help="Longest side of the normal and colour maps.")] = DEFAULT_TEXELS,
    no_repair: Annotated[bool, typer.Option("--no-repair", help="Take the mesh as it is: close no holes, turn no faces.")] = False,
    no_wait: Annotated[bool, typer.Option("--no-wait", help="Return when the service has the bytes.")] = False,
    as_json: AsJson = False,
    url: Url = DEFAULT_URL,
) -> None:
    """Upload a mesh, wait until it is ready, and print its id.

    `silhouette upload bunny.ply` or `ID=$(silhouette upload bunny.ply --hull-faces 500)`
    """
    options: dict[str, Any] = {"hull_faces": hull_faces, "texels": texels, "repair": "never" if no_repair else "auto"}
    with Client(url) as client:
        mesh = client.upload(file, **options) if no_wait else upload_and_wait(client, file, err, **options)
    _print_json(mesh) if as_json else print(mesh.id)


@app.command()
def render(  # noqa: PLR0913 - the options of a command are its language
    mesh: MeshArgument,
    *,
    output: Annotated[Path, typer.Option("--output", "-o", help="File to write: .png, .webp, .jpg or .raw; - for PNG to stdout.")],
    azimuth: Azimuth = 30.0,
    elevation: Elevation = 20.0,
    eye: Eye = None,
    target: Target = None,
    fov: Fov = 45.0,
    size: Size = "512",
    background: Annotated[str, typer.Option(help="transparent or #rrggbb.")] = "transparent",
    shading: Annotated[ShadingMode, typer.Option(help="How the surface is shaded.")] = ShadingMode.LAMBERT,
    antialias: Annotated[
        Antialias, typer.Option(help="How the outline is smoothed; msaa and ssaa need the original.")
    ] = Antialias.COVERAGE,
    source: Annotated[Source, typer.Option(help="Draw the clipped hull or the original mesh.")] = Source.AUTO,
    url: Url = DEFAULT_URL,
) -> None:
    """Render a picture of a mesh.

    `silhouette render bunny.ply -o bunny.png --azimuth 40 --size 800x600`

    `silhouette render 3f2a91 -o - --eye 0,0,3 --background "#ffffff" | display`
    """
    width, height = _size(size)
    with Client(url) as client:
        picture = client.picture(
            _mesh_id(client, mesh),
            camera=_camera(azimuth, elevation, eye, target, fov),
            width=width,
            height=height,
            background=background,
            shading={"mode": shading},
            accuracy={"antialias": antialias, "source": source},
            format=_by_suffix(output, IMAGE_SUFFIXES, ImageFormat.PNG),
        )
    _write(output, picture.body, f"{picture.frame_ms:.1f} ms: {picture.plan} ({picture.accuracy})")


@app.command()
def silhouette(
    mesh: MeshArgument,
    output: Annotated[Path, typer.Option("--output", "-o", help="File to write: .svg, .json or .bin; - for JSON to stdout.")],
    azimuth: Azimuth = 30.0,
    elevation: Elevation = 20.0,
    eye: Eye = None,
    target: Target = None,
    size: Size = "512",
    url: Url = DEFAULT_URL,
) -> None:
    """Write the silhouette of a mesh as a drawing (SVG) or as edges and closed contours (JSON).

    `silhouette silhouette bunny.ply -o bunny.svg --azimuth 40`

    `silhouette silhouette 3f2a91 -o - | jq .edge_count`
    """
    width, height = _size(size)
    form = _by_suffix(output, SILHOUETTE_SUFFIXES, "json")
    camera = _camera(azimuth, elevation, eye, target, 45.0)
    with Client(url) as client:
        body = client.silhouette_document(_mesh_id(client, mesh), form, camera=camera, project={"width": width, "height": height})
    _write(output, body, f"{len(body) / 1024:.1f} KiB")


@app.command("list")
def list_meshes(
    limit: Annotated[int, typer.Option(min=1, help="At most so many, newest first.")] = 50, as_json: AsJson = False, url: Url = DEFAULT_URL
) -> None:
    """List the meshes of the service, newest first.

    `silhouette list` or `silhouette list --json | jq -r '.[].id'`
    """
    with Client(url) as client:
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


@app.command()
def info(mesh: IdArgument, as_json: AsJson = False, url: Url = DEFAULT_URL) -> None:
    """Say everything about a mesh: stages, measured facts, what it can do and what was repaired.

    `silhouette info 3f2a91`
    """
    with Client(url) as client:
        found = client.info(_mesh_id(client, mesh))
    if as_json:
        _print_json(found)
        return
    table = Table(box=None, show_header=False)
    for name, value in _facts(found):
        table.add_row(f"[dim]{name}", value)
    out.print(table)


@app.command()
def delete(mesh: IdArgument, url: Url = DEFAULT_URL) -> None:
    """Remove a mesh and everything made from it; what is being done for it is cancelled.

    `silhouette delete 3f2a91`
    """
    with Client(url) as client:
        client.delete(_mesh_id(client, mesh))


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
    err.print(f"[bold red]error[/] {_escaped(message)}", highlight=False, soft_wrap=True)
    sys.exit(1)


def _escaped(text: str) -> str:
    return text.replace("[", r"\[")


def _become(module: str, arguments: list[str]) -> NoReturn:
    """Turn this process into `python -m module`, so that signals and the exit status are its own."""
    sys.stdout.flush()
    os.execv(sys.executable, [sys.executable, "-m", module, *arguments])


def _mesh_id(client: Client, mesh: str) -> str:
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


def _camera(azimuth: float, elevation: float, eye: str | None, target: str | None, fov: float) -> dict[str, Any]:
    if eye is None:
        if target is not None:
            raise ValueError("--target needs --eye: without it the camera turns about the mesh")
        return {"orbit": {"azimuth_deg": azimuth, "elevation_deg": elevation, "fov_y_deg": fov}}
    place: dict[str, Any] = {"eye": _vector(eye, "--eye"), "fov_y_deg": fov}
    return place if target is None else place | {"target": _vector(target, "--target")}


def _vector(text: str, option: str) -> list[float]:
    parts = text.split(",")
    if len(parts) != 3 or not all(re.fullmatch(r"\s*[-+]?[\d.]+([eE][-+]?\d+)?\s*", part) for part in parts):
        raise ValueError(f"{option} takes three numbers with commas between, like 0,0,3")
    return [float(part) for part in parts]


def _size(text: str) -> tuple[int, int]:
    found = re.fullmatch(r"(\d+)(?:x(\d+))?", text)
    if not found:
        raise ValueError("--size takes pixels like 800x600, or one number for a square")
    return int(found[1]), int(found[2] or found[1])


def _by_suffix(path: Path, known: dict[str, Any], for_stdout: Any) -> Any:
    if str(path) == "-":
        return for_stdout
    if path.suffix.lower() not in known:
        raise ValueError(f"--output {path}: the ending must be one of {', '.join(known)}")
    return known[path.suffix.lower()]


def _write(path: Path, body: bytes, said: str) -> None:
    if str(path) == "-":
        sys.stdout.buffer.write(body)
        sys.stdout.buffer.flush()
        return
    path.write_bytes(body)
    err.print(f"[green]{path}[/]  {said}", highlight=False, soft_wrap=True)


def _print_json(mesh: MeshInfo) -> None:
    print(mesh.model_dump_json(exclude_none=True))


def _facts(mesh: MeshInfo) -> list[tuple[str, str]]:
    facts = [("id", mesh.id), ("name", mesh.name), ("status", str(mesh.status)), ("created", f"{mesh.created:%Y-%m-%d %H:%M:%S}")]
    if mesh.error:
        facts.append(("error", f"[red]{_escaped(mesh.error.detail)}"))
    if mesh.stats:
        facts += [(name, _plain(value)) for name, value in mesh.stats if name != "bounds"]
        facts.append(("bounds", " to ".join("({})".format(", ".join(f"{x:.6g}" for x in corner)) for corner in mesh.stats.bounds)))
    if mesh.hull:
        facts.append(("hull", f"{mesh.hull.faces:,} faces, {mesh.hull.volume_excess:.1%} more volume"))
    for name, capability in mesh.capabilities.items():
        facts.append((name, "yes" if capability.available else f"no: {capability.reason}"))
    facts += [(f"stage {s.name}", f"{s.status} {'' if s.seconds is None else f'{s.seconds:.2f} s'}") for s in mesh.stages]
    return facts + [(name.replace("_", " "), _plain(value)) for name, value in (mesh.repairs or {}).items() if value]


def _plain(value: object) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    return f"{value:,}" if isinstance(value, int) else str(value)


if __name__ == "__main__":
    main()
