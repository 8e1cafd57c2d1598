"""Commands about sequences of pictures: turntable, frames."""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from client.api import DEFAULT_URL
from client.commands.choosing import Key, MeshArgument, Url, chosen
from client.commands.console import err, write
from client.commands.pictures import lines_of
from client.commands.viewing import Azimuth, Elevation, Eye, Fov, Moved, Size, Target, by_suffix, camera_of, sides_of
from schemas.lines import LineMethod
from schemas.render import Fill, ShadingMode
from schemas.sequence import SequenceFormat

if TYPE_CHECKING:
    from client.positions import Positions

SUFFIXES = {".webp": SequenceFormat.WEBP, ".apng": SequenceFormat.APNG, ".png": SequenceFormat.APNG, ".zip": SequenceFormat.ZIP}

Output = Annotated[Path, typer.Option("--output", "-o", help="File to write: .webp, .png or .apng (animated), .zip; - for WebP to stdout.")]
Background = Annotated[str, typer.Option(help="transparent or #rrggbb.")]
Mode = Annotated[ShadingMode, typer.Option("--shading", help="How the surface is shaded.")]
Method = Annotated[LineMethod | None, typer.Option("--lines", help="Draw lines over it, by this method; from the original mesh.")]
LineWidth = Annotated[float, typer.Option(help="Pixels.")]
Ridges = Annotated[bool, typer.Option("--ridges", help="Lines at sharp edges, too.")]
Under = Annotated[Fill, typer.Option("--fill", help="What lies under lines: the shaded surface, white, or nothing.")]
Fps = Annotated[float, typer.Option(help="Frames a second.")]


@dataclass(frozen=True, kw_only=True)
class Film:
    """What every sequence is told: where it goes, how its frames look, and which service draws it."""

    output: Output
    fps: Fps = 25.0
    azimuth: Azimuth = 30.0
    elevation: Elevation = 20.0
    fov: Fov = 45.0
    size: Size = "512"
    background: Background = "transparent"
    shading: Mode = ShadingMode.LAMBERT
    lines: Method = None
    line_width: LineWidth = 1.5
    ridges: Ridges = False
    fill: Under = Fill.SHADED
    url: Url = DEFAULT_URL
    key: Key = None

    def request(self, eye: str | None = None, target: str | None = None) -> dict[str, Any]:
        """Fields of the request. Raises ValueError for a size or place that is none."""
        width, height = sides_of(self.size)
        return {
            "camera": camera_of(self.azimuth, self.elevation, eye, target, self.fov),
            "width": width,
            "height": height,
            "fps": self.fps,
            "background": self.background,
            "shading": {"mode": self.shading, "fill": self.fill},
            "lines": None if self.lines is None else lines_of(self.lines, self.line_width, ridges=self.ridges),
        }


def _with_film(command: Callable[..., None]) -> Callable[..., None]:
    """The command with its own options and, after them, those of a film instead of its parameter `film`."""
    shared = inspect.signature(Film, eval_str=True).parameters

    @functools.wraps(command)
    def called(**given: Any) -> None:
        film = Film(**{name: given.pop(name) for name in shared})
        command(**given, film=film)

    own = inspect.signature(command, eval_str=True)
    keyword = [own.parameters[name].replace(kind=inspect.Parameter.KEYWORD_ONLY) for name in own.parameters if name != "film"]
    called.__signature__ = own.replace(parameters=[*keyword, *shared.values()])  # type: ignore[attr-defined]
    called.__annotations__ = {one.name: one.annotation for one in (*keyword, *shared.values())}
    return called


@_with_film
def turntable(
    mesh: MeshArgument,
    *,
    frames: Annotated[int, typer.Option(min=1, help="How many.")] = 36,
    degrees: Annotated[float, typer.Option(help="How far round; below 0 the other way.")] = 360.0,
    film: Film,
) -> None:
    """Render a mesh turning round, as an animation or as numbered pictures.

    `silhouette turntable bunny.ply -o turn.webp --frames 60`

    `silhouette turntable 3f2a91 -o turn.zip --lines edge_mesh --ridges --fill white`
    """
    _draw(film, mesh, film.request() | {"turn": {"frames": frames, "degrees": degrees}})


@_with_film
def frames(
    mesh: MeshArgument,
    *,
    positions: Moved = None,
    file_order: Annotated[
        bool, typer.Option("--file-order", help="The positions, an .npy, are in the order of the file that was uploaded.")
    ] = False,
    turn: Annotated[float | None, typer.Option(help="Degrees that the camera turns meanwhile.")] = None,
    eye: Eye = None,
    target: Target = None,
    film: Film,
) -> None:
    """Render a mesh whose vertices move: the positions of all frames in one file, those of a frame after those of another.

    `silhouette original 3f2a91 -o rest.npy` has the vertices to be moved; an .npy of (frames, vertices, 3) moves them:

    `silhouette frames 3f2a91 --positions moved.npy -o moved.webp --fps 30 --lines edge_mesh --ridges`

    With `--file-order` it has the vertices of the file that was uploaded, in their order.
    """
    if file_order and positions is None:
        raise ValueError("--file-order is about --positions")
    fields = film.request(eye, target) | {"turn": None if turn is None else {"degrees": turn}}
    _draw(film, mesh, fields, positions, file_order=file_order)


def _draw(film: Film, mesh: str, fields: dict[str, Any], positions: Path | None = None, *, file_order: bool = False) -> None:
    """Have it drawn, and write it."""
    form = by_suffix(film.output, SUFFIXES, SequenceFormat.WEBP)
    with chosen(film.url, mesh, film.key) as (client, mesh_id), err.status("frames are being drawn"):
        moved: Positions | None = positions
        if file_order and positions is not None:
            import numpy as np

            moved = client.original(mesh_id).ordered(np.load(positions, allow_pickle=False))
        drawn = client.frames(mesh_id, positions=moved, format=form, **fields)
    write(film.output, drawn.body, f"{drawn.frame_ms:.0f} ms, {len(drawn.body) / 1024:.0f} KiB: {drawn.plan} ({drawn.accuracy})")
