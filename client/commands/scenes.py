"""The command about several meshes in one picture."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Annotated, Any

import typer

from client.api import DEFAULT_URL, Client
from client.commands.choosing import Key, Url, mesh_id
from client.commands.console import write
from client.commands.pictures import IMAGE_SUFFIXES
from client.commands.viewing import by_suffix, sides_of
from schemas.render import ImageFormat

SceneArgument = Annotated[Path, typer.Argument(metavar="SCENE.json", help="The scene as the API takes it; - for stdin.")]


def scene(
    file: SceneArgument,
    output: Annotated[Path, typer.Option("--output", "-o", help="File to write: .png, .webp, .jpg or .raw; - for PNG to stdout.")],
    size: Annotated[str | None, typer.Option(metavar="WxH", help="Pixels, instead of what the file says.")] = None,
    url: Url = DEFAULT_URL,
    key: Key = None,
) -> None:
    """Render several meshes with transforms in one picture.

    In the file, `mesh` of an object may be an id, the beginning of one, or the path of a mesh beside the file, which is uploaded first:
    `{"objects": [{"mesh": "bunny.ply"}, {"mesh": "3f2a91", "transform": {"translate": [2, 0, 0], "scale": 0.5}}]}`

    With `"lines": {}` beside the objects, or in one of them, silhouettes are drawn; `"lines": {"ridge": {}}` adds ridges.

    `silhouette scene scene.json -o scene.png --size 800x600`
    """
    fields = _read(file)
    if size is not None:
        fields["width"], fields["height"] = sides_of(size)
    fields["format"] = by_suffix(output, IMAGE_SUFFIXES, ImageFormat.PNG)
    objects = fields.pop("objects", [])
    with Client(url, key=key) as client:
        known: dict[str, str] = {}
        objects = [_with_id(client, item, file.parent, known) for item in objects]
        picture = client.scene_picture(objects, **fields)
    write(output, picture.body, f"{picture.frame_ms:.1f} ms: {picture.plan} ({picture.accuracy})")


def _read(file: Path) -> dict[str, Any]:
    """The scene in a file. Raises ValueError when it is none, OSError when there is no such file."""
    text = sys.stdin.read() if str(file) == "-" else file.read_text("utf-8")
    try:
        fields = json.loads(text)
    except json.JSONDecodeError as error:
        raise ValueError(f"{file} is not valid JSON: {error}") from None
    is_scene = isinstance(fields, dict) and isinstance(fields.get("objects", []), list)
    if not is_scene:
        raise ValueError(f'{file} holds no scene: it must be like {{"objects": [{{"mesh": "ID"}}]}}')
    return dict(fields)


def _with_id(client: Client, item: Any, folder: Path, known: dict[str, str]) -> Any:
    """The object with the id of its mesh, each found once; what is no object is left for the service to refuse."""
    if not isinstance(item, dict) or not isinstance(item.get("mesh"), str):
        return item
    name = item["mesh"]
    if name not in known:
        beside = folder / name
        known[name] = mesh_id(client, str(beside) if beside.is_file() else name)
    return {**item, "mesh": known[name]}
