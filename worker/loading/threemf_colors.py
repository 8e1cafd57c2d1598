"""Colours of a 3MF file. Runs only in the limited child.

trimesh reads the geometry of 3MF and no materials, so the model is read once more for these, if it names any: base materials of the
core specification (section 5) and colour groups of the materials extension (section 3), which a triangle picks by group and
by index, one for each corner. Textures, composites and multi-properties are left out.
"""

from __future__ import annotations

import io
import re
import zipfile
from collections.abc import Iterator
from typing import Any

import numpy as np

from schemas.conventions import U1
from worker.loading.colors import NO_COLOR

_HEX = re.compile(r"#([0-9a-fA-F]{6})([0-9a-fA-F]{2})?")
Groups = dict[str, list[tuple[int, ...]]]


def corner_colors(data: bytes) -> list[U1 | None] | None:
    """(f, 3, 4) u1 sRGB of each object that has a mesh, in the order of the file; None for those without colour.

    None where the file has none, or has models in several parts, whose objects are not told apart here.
    """
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        models = [name for name in archive.namelist() if name.lower().endswith(".model")]
        if len(models) != 1:
            return None
        model = archive.read(models[0])
    if not any("color".encode(encoding) in model for encoding in ("utf-8", "utf-16-le")):
        return None
    found = list(_objects(model))
    return found if any(colors is not None for colors in found) else None


def _objects(model: bytes) -> Iterator[U1 | None]:
    from lxml import etree

    groups: Groups = {}
    tags = ("{*}basematerials", "{*}colorgroup", "{*}object")
    for _, node in etree.iterparse(io.BytesIO(model), tag=tags, events=("end",), resolve_entities=False, no_network=True):
        if node.tag.endswith("}object"):
            triangles = [t for mesh in node.iter("{*}mesh") for t in mesh.iter("{*}triangle")]
            if node.find("{*}mesh") is not None:
                yield _of_triangles(triangles, groups, node.get("pid"), node.get("pindex", "0"))
            node.clear()
        else:
            name = "displaycolor" if node.tag.endswith("}basematerials") else "color"
            groups[node.get("id", "")] = [_rgba(entry.get(name, "")) for entry in node]


def _of_triangles(triangles: list[Any], groups: Groups, group: str | None, index: str) -> U1 | None:
    """Colours of an object's triangles; group and index are those of the object, for triangles that name none."""
    out = np.tile(np.array(NO_COLOR, np.uint8), (len(triangles), 3, 1))
    colored = False
    for row, triangle in zip(out, triangles, strict=True):
        known = groups.get(triangle.get("pid", group))
        if known is None:
            continue
        first = triangle.get("p1", index)
        for corner, name in enumerate(("p1", "p2", "p3")):
            picked = triangle.get(name, first)
            if picked.isdecimal() and int(picked[:9]) < len(known):
                row[corner] = known[int(picked[:9])]
                colored = True
    return out if colored else None


def _rgba(text: str) -> tuple[int, ...]:
    """The bytes of #RRGGBB or #RRGGBBAA."""
    match = _HEX.fullmatch(text)
    if match is None:
        return NO_COLOR
    return tuple(bytes.fromhex(match[1] + (match[2] or "ff")))
