"""Commands about sequences of pictures: turntable, frames."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from client.api import DEFAULT_URL
from client.commands.choosing import Key, MeshArgument, Url, chosen
from client.commands.console import err, write
from client.commands.pictures import lines_of
from client.commands.viewing import Azimuth, Elevation, Eye, Fov, Moved, Size, Target, by_suffix, camera_of, sides_of
from client.positions import Positions
from schemas.lines import LineMethod
from schemas.render import Fill, ShadingMode
from schemas.sequence import SequenceFormat

SUFFIXES = {".webp": SequenceFormat.WEBP, ".apng": SequenceFormat.APNG, ".png": SequenceFormat.APNG, ".zip": SequenceFormat.ZIP}

Output = Annotated[Path, typer.Option("--output", "-o", help="File to write: .webp, .png or .apng (animated), .zip; - for WebP to stdout.")]
Background = Annotated[str, typer.Option(help="transparent or #rrggbb.")]
Mode = Annotated[ShadingMode, typer.Option("--shading", help="How the surface is shaded.")]
Method = Annotated[LineMethod | None, typer.Option("--lines", help="Draw lines over it, by this method; from the original mesh.")]
LineWidth = Annotated[float, typer.Option(help="Pixels.")]
Ridges = Annotated[bool, typer.Option("--ridges", help="Lines at sharp edges, too.")]
Under = Annotated[Fill, typer.Option("--fill", help="What lies under lines: the shaded surface, white, or nothing.")]
Fps = Annotated[float, typer.Option(help="Frames a second.")]


def turntable(  # noqa: PLR0913 - the options of a command are its language
    mesh: MeshArgument,
    *,
    output: Output,
    frames: Annotated[int, typer.Option(min=1, help="How many.")] = 36,
    degrees: Annotated[float, typer.Option(help="How far round; below 0 the other way.")] = 360.0,
    fps: Fps = 25.0,
    azimuth: Azimuth = 30.0,
    elevation: Elevation = 20.0,
    fov: Fov = 45.0,
    size: Size = "512",
    background: Background = "transparent",
    shading: Mode = ShadingMode.LAMBERT,
    lines: Method = None,
    line_width: LineWidth = 1.5,
    ridges: Ridges = False,
    fill: Under = Fill.SHADED,
    url: Url = DEFAULT_URL,
    key: Key = None,
) -> None:
    """Render a mesh turning round, as an animation or as numbered pictures.

    `silhouette turntable bunny.ply -o turn.webp --frames 60`

    `silhouette turntable 3f2a91 -o turn.zip --lines edge_mesh --ridges --fill white`
    """
    fields = {
        "camera": camera_of(azimuth, elevation, None, None, fov),
        "turn": {"frames": frames, "degrees": degrees},
        **_common(size, fps, background, shading, fill),
        "lines": None if lines is None else lines_of(lines, line_width, ridges=ridges),
    }
    _draw((url, key), mesh, output, fields)


def frames(  # noqa: PLR0913 - as above
    mesh: MeshArgument,
    *,
    output: Output,
    positions: Moved = None,
    file_order: Annotated[
        bool, typer.Option("--file-order", help="The positions, an .npy, are in the order of the file that was uploaded.")
    ] = False,
    turn: Annotated[float | None, typer.Option(help="Degrees that the camera turns meanwhile.")] = None,
    fps: Fps = 25.0,
    azimuth: Azimuth = 30.0,
    elevation: Elevation = 20.0,
    eye: Eye = None,
    target: Target = None,
    fov: Fov = 45.0,
    size: Size = "512",
    background: Background = "transparent",
    shading: Mode = ShadingMode.LAMBERT,
    lines: Method = None,
    line_width: LineWidth = 1.5,
    ridges: Ridges = False,
    fill: Under = Fill.SHADED,
    url: Url = DEFAULT_URL,
    key: Key = None,
) -> None:
    """Render a mesh whose vertices move: the positions of all frames in one file, those of a frame after those of another.

    `silhouette original 3f2a91 -o rest.npy` has the vertices to be moved; an .npy of (frames, vertices, 3) moves them:

    `silhouette frames 3f2a91 --positions moved.npy -o moved.webp --fps 30 --lines edge_mesh --ridges`

    With `--file-order` it has the vertices of the file that was uploaded, in their order.
    """
    if file_order and positions is None:
        raise ValueError("--file-order is about --positions")
    fields = {
        "camera": camera_of(azimuth, elevation, eye, target, fov),
        "turn": None if turn is None else {"degrees": turn},
        **_common(size, fps, background, shading, fill),
        "lines": None if lines is None else lines_of(lines, line_width, ridges=ridges),
    }
    _draw((url, key), mesh, output, fields, positions, file_order=file_order)


def _common(size: str, fps: float, background: str, shading: ShadingMode, fill: Fill) -> dict[str, Any]:
    """Fields that both commands fill. Raises ValueError for a size that is none."""
    width, height = sides_of(size)
    return {"width": width, "height": height, "fps": fps, "background": background, "shading": {"mode": shading, "fill": fill}}


def _draw(
    service: tuple[str, str | None],
    mesh: str,
    output: Path,
    fields: dict[str, Any],
    positions: Path | None = None,
    *,
    file_order: bool = False,
) -> None:
    """Have it drawn by a service (its address, and the key it asks for), and write it."""
    form = by_suffix(output, SUFFIXES, SequenceFormat.WEBP)
    url, key = service
    with chosen(url, mesh, key) as (client, mesh_id), err.status("frames are being drawn"):
        moved: Positions | None = positions
        if file_order and positions is not None:
            moved = client.original(mesh_id).ordered(np.load(positions, allow_pickle=False))
        film = client.frames(mesh_id, positions=moved, format=form, **fields)
    write(output, film.body, f"{film.frame_ms:.0f} ms, {len(film.body) / 1024:.0f} KiB: {film.plan} ({film.accuracy})")
