"""Which view a command is about, and in which form it is written."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Annotated, Any

import typer

Azimuth = Annotated[float, typer.Option(help="Degrees about +y, from +z.")]
Elevation = Annotated[float, typer.Option(help="Degrees towards +y, -90 to 90.")]
Eye = Annotated[str | None, typer.Option(metavar="X,Y,Z", help="Eye in model units, instead of azimuth and elevation.")]
Target = Annotated[str | None, typer.Option(metavar="X,Y,Z", help="What the eye looks at; the origin if not given.")]
Fov = Annotated[float, typer.Option(help="Vertical field of view, degrees.")]
Smooth = Annotated[bool, typer.Option("--smooth", help="Curve the outline by the surface's normals, for coarse meshes.")]
MaxError = Annotated[
    float | None, typer.Option(help="Pixels by which the outline may be off, which makes it faster; exact if not given.", min=0.0)
]
StrokeFields = Annotated[
    list[str] | None,
    typer.Option(
        "--stroke",
        metavar="FIELD=VALUE",
        help="How lines change along themselves: width_by or opacity_by=depth, curvature or angle; least=0.2; nib_deg=40; dash=12,6; "
        "wobble_px=2; wobble_length_px=40; seed=1. May be given several times.",
    ),
]
Moved = Annotated[
    Path | None,
    typer.Option(
        "--positions", metavar="FILE", exists=True, dir_okay=False, help="Move the vertices: .npy or bare float32; see `original`."
    ),
]
Size = Annotated[str, typer.Option(metavar="WxH", help="Pixels, like 800x600, or one number for a square.")]


def camera_of(azimuth: float, elevation: float, eye: str | None, target: str | None, fov: float) -> dict[str, Any]:
    """A camera as requests hold it: an orbit, or the eye where one is given. Raises ValueError for text that is no vector."""
    if eye is None:
        if target is not None:
            raise ValueError("--target needs --eye: without it the camera turns about the mesh")
        return {"orbit": {"azimuth_deg": azimuth, "elevation_deg": elevation, "fov_y_deg": fov}}
    place: dict[str, Any] = {"eye": _vector(eye, "--eye"), "fov_y_deg": fov}
    return place if target is None else place | {"target": _vector(target, "--target")}


def stroke_of(given: list[str] | None) -> dict[str, Any] | None:
    """A stroke as requests hold it, from options like `dash=12,6`; None without any. Raises ValueError for what is not of that form."""
    stroke: dict[str, Any] = {}
    for option in given or []:
        name, equals, value = option.partition("=")
        if not (name and equals and value):
            raise ValueError("--stroke takes a field and its value, like wobble_px=2")
        stroke[name] = value.split(",") if name == "dash" else value
    return stroke or None


def _vector(text: str, option: str) -> list[float]:
    parts = text.split(",")
    if len(parts) != 3 or not all(re.fullmatch(r"\s*[-+]?[\d.]+([eE][-+]?\d+)?\s*", part) for part in parts):
        raise ValueError(f"{option} takes three numbers with commas between, like 0,0,3")
    return [float(part) for part in parts]


def sides_of(text: str) -> tuple[int, int]:
    """Width and height of "800x600" or "512", pixels. Raises ValueError."""
    found = re.fullmatch(r"(\d+)(?:x(\d+))?", text)
    if not found:
        raise ValueError("--size takes pixels like 800x600, or one number for a square")
    return int(found[1]), int(found[2] or found[1])


def by_suffix(path: Path, known: dict[str, Any], for_stdout: Any) -> Any:
    """What the ending of a path means, or `for_stdout` for the path -. Raises ValueError for an ending that is not known."""
    if str(path) == "-":
        return for_stdout
    if path.suffix.lower() not in known:
        raise ValueError(f"--output {path}: the ending must be one of {', '.join(known)}")
    return known[path.suffix.lower()]
