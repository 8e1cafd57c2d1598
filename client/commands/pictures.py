"""Commands about views: render, silhouette."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from client.api import DEFAULT_URL
from client.commands.choosing import Key, MeshArgument, Once, Url, chosen, unkept
from client.commands.console import write
from client.commands.viewing import (
    Azimuth,
    Elevation,
    Eye,
    Fov,
    MaxError,
    Moved,
    Size,
    Smooth,
    StrokeFields,
    Target,
    by_suffix,
    camera_of,
    sides_of,
    stroke_of,
)
from schemas.lines import LineKind, LineMethod
from schemas.render import Antialias, Fill, ImageFormat, ShadingMode, Source

IMAGE_SUFFIXES = {
    ".png": ImageFormat.PNG,
    ".webp": ImageFormat.WEBP,
    ".jpg": ImageFormat.JPEG,
    ".jpeg": ImageFormat.JPEG,
    ".raw": ImageFormat.RAW,
}
SILHOUETTE_SUFFIXES = {".json": "json", ".svg": "svg", ".bin": "binary", ".dxf": "dxf"}


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
    antialias: Annotated[Antialias, typer.Option(help="How the outline is smoothed; msaa and ssaa need the original.")] = Antialias.AUTO,
    source: Annotated[Source, typer.Option(help="Draw the clipped hull or the original mesh.")] = Source.AUTO,
    smooth: Smooth = False,
    max_error: MaxError = None,
    budget: Annotated[float | None, typer.Option(help="Milliseconds that drawing may take: the most accurate picture that fits.")] = None,
    min_psnr: Annotated[float | None, typer.Option(help="Decibels that shading must reach: the cheapest hull and maps that do.")] = None,
    level: Annotated[int | None, typer.Option(help="Level that the outline is taken from, finest first; -1 is the mesh.")] = None,
    hull_faces: Annotated[int | None, typer.Option(help="Draw the hull of the nearest size.")] = None,
    texels: Annotated[int | None, typer.Option(help="Draw with maps of at most so many texels a side.")] = None,
    lines: Annotated[LineMethod | None, typer.Option(help="Draw lines over it, by this method; from the original mesh.")] = None,
    line_width: Annotated[float, typer.Option(help="Pixels.")] = 1.5,
    ridges: Annotated[bool, typer.Option("--ridges", help="Lines at sharp edges, too.")] = False,
    stroke: StrokeFields = None,
    fill: Annotated[Fill, typer.Option(help="What lies under lines: the shaded surface, white, or nothing.")] = Fill.SHADED,
    positions: Moved = None,
    once: Once = False,
    url: Url = DEFAULT_URL,
    key: Key = None,
) -> None:
    """Render a picture of a mesh.

    `silhouette render bunny.ply -o bunny.png --azimuth 40 --size 800x600`

    `silhouette render bunny.ply -o quick.png --budget 3` or `--max-error 0.5`; `silhouette accuracy bunny.ply` says what there is.

    `silhouette render part.stl -o drawing.png --lines edge_mesh --ridges --fill white`

    `silhouette render bunny.ply -o sketch.png --lines strokes --line-width 4 --stroke width_by=angle --stroke wobble_px=2 --fill white`

    `silhouette render part.stl -o part.png --once` keeps nothing of it.

    `silhouette render 3f2a91 -o - --eye 0,0,3 --background "#ffffff" | display`
    """
    width, height = sides_of(size)
    if stroke and lines is None:
        raise ValueError("--stroke needs --lines strokes")
    fields = {
        "camera": camera_of(azimuth, elevation, eye, target, fov),
        "width": width,
        "height": height,
        "background": background,
        "shading": {"mode": shading, "fill": fill},
        "lines": None if lines is None else lines_of(lines, line_width, ridges=ridges) | {"stroke": stroke_of(stroke)},
        "accuracy": {
            "antialias": antialias,
            "source": source,
            "smooth": smooth,
            "max_error_px": max_error,
            "budget_ms": budget,
            "min_psnr_db": min_psnr,
            "level": level,
            "hull_faces": hull_faces,
            "texels": texels,
        },
        "format": by_suffix(output, IMAGE_SUFFIXES, ImageFormat.PNG),
    }
    if once:
        _unmoved(positions)
        with unkept(url, mesh, key) as (client, path):
            picture = client.picture_once(path, **fields)
    else:
        with chosen(url, mesh, key) as (client, mesh_id):
            picture = client.picture(mesh_id, positions=positions, **fields)
    write(output, picture.body, f"{picture.frame_ms:.1f} ms: {picture.plan} ({picture.accuracy})")


def _unmoved(positions: Path | None) -> None:
    """Raise ValueError for positions of a file that is not kept."""
    if positions is not None:
        raise ValueError("--positions moves a mesh that the service keeps; with --once, give the file as it is to be drawn")


def lines_of(method: LineMethod, width: float, *, ridges: bool) -> dict[str, Any]:
    """Lines of one width, as a request holds them; what is sharp is drawn too if ridges are."""
    style = {"width": width}
    sharp = style if ridges else None
    return {"method": method, "silhouette": style, "boundary": style, "ridge": sharp, "valley": sharp}


def silhouette(  # noqa: PLR0913 - as above
    mesh: MeshArgument,
    output: Annotated[Path, typer.Option("--output", "-o", help="File to write: .svg, .dxf, .json or .bin; - for JSON to stdout.")],
    azimuth: Azimuth = 30.0,
    elevation: Elevation = 20.0,
    eye: Eye = None,
    target: Target = None,
    size: Size = "512",
    *,
    smooth: Smooth = False,
    max_error: MaxError = None,
    kinds: Annotated[
        str | None, typer.Option(help="Lines: silhouette, boundary, ridge, valley, crease, intersection; with commas.")
    ] = None,
    visible_only: Annotated[bool, typer.Option("--visible-only", help="Lines without what is hidden.")] = False,
    angle: Annotated[float, typer.Option(help="Degrees by which faces turn at a ridge, valley or crease, at least.")] = 60.0,
    simplify_px: Annotated[float | None, typer.Option(help="Leave out points of lines that are so near to what remains.")] = None,
    smooth_px: Annotated[float | None, typer.Option(help="Round corners of lines, at most so far from where they are.")] = None,
    line_width: Annotated[float | None, typer.Option(help="Pixels, of all lines of a drawing.")] = None,
    stroke: StrokeFields = None,
    positions: Moved = None,
    once: Once = False,
    url: Url = DEFAULT_URL,
    key: Key = None,
) -> None:
    """Write the silhouette of a mesh as a drawing (SVG, DXF) or as edges and closed contours (JSON).

    `silhouette silhouette bunny.ply -o bunny.svg --azimuth 40`

    `silhouette silhouette part.stl -o part.dxf --visible-only --kinds silhouette,ridge,valley --angle 30`

    `silhouette silhouette bunny.ply -o sketch.svg --visible-only --line-width 5 --stroke width_by=depth --stroke wobble_px=2`

    `silhouette silhouette 3f2a91 -o - | jq .edge_count`
    """
    width, height = sides_of(size)
    form = by_suffix(output, SILHOUETTE_SUFFIXES, "json")
    image = {"width": width, "height": height}
    fields: dict[str, Any] = {
        "camera": camera_of(azimuth, elevation, eye, target, 45.0),
        "project": image,
        "smooth": smooth,
        "max_error_px": max_error,
    }
    fields |= {"kinds": None if kinds is None else kinds.split(","), "visible_only": visible_only}
    fields |= {"ridge_deg": angle, "valley_deg": angle, "crease_deg": angle, "simplify_px": simplify_px, "smooth_px": smooth_px}
    fields |= {"line_width": {} if line_width is None else dict.fromkeys(LineKind, line_width), "stroke": stroke_of(stroke)}
    if once:
        _unmoved(positions)
        with unkept(url, mesh, key) as (client, path):
            body = client.silhouette_once(path, form, **fields)
    else:
        with chosen(url, mesh, key) as (client, mesh_id):
            body = client.silhouette_document(mesh_id, form, positions=positions, **fields)
    write(output, body, f"{len(body) / 1024:.1f} KiB")
