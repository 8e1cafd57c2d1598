"""Lines of an image written down: parts of the JSON and binary answers, a drawing as SVG, and one as DXF.

The DXF is of release 12 (AutoCAD DXF Reference, POLYLINE, VERTEX, LAYER and LTYPE), which every reader knows; y is upwards there.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from itertools import pairwise
from typing import Any

import numpy as np
import orjson

from schemas.conventions import F8
from schemas.lines import LineKind
from service.camera import View
from service.silhouette.lines import KINDS, VectorLines

PIXEL_DIGITS = 4
"""Decimals of pixel coordinates in JSON and DXF."""
DRAWN_DIGITS = 2
"""Decimals of pixel coordinates in drawings: a hundredth of a pixel."""
LOOKS = {
    LineKind.SILHOUETTE: ("#111111", 2.0, 7),
    LineKind.BOUNDARY: ("#7a2e8e", 1.6, 6),
    LineKind.RIDGE: ("#1f4e8c", 1.2, 5),
    LineKind.VALLEY: ("#2a7a4b", 1.2, 3),
    LineKind.CREASE: ("#444444", 1.2, 8),
    LineKind.INTERSECTION: ("#b3261e", 1.2, 1),
}
"""Colour, width in pixels, and number of the colour in DXF."""
DASH_PX, HIDDEN_WIDTH, HIDDEN_OPACITY = (4.0, 3.0), 0.6, 0.55
"""Of hidden lines: dash and gap, part of the width of visible ones, opacity."""


def lines_json(lines: VectorLines) -> list[dict[str, Any]]:
    """`schemas.render.Line` of each polyline, for orjson."""
    points = np.round(lines.points, PIXEL_DIGITS)
    flags = zip(lines.kinds.tolist(), lines.visible.tolist(), lines.closed.tolist(), strict=True)
    vertices = None if lines.vertices is None else [None if v < 0 else v for v in lines.vertices.tolist()]
    found = []
    for (kind, visible, closed), (a, b) in zip(flags, pairwise(lines.offsets.tolist()), strict=True):
        line = {"kind": KINDS[kind], "visible": visible, "closed": closed, "points": points[a:b]}
        found.append(line if vertices is None else line | {"vertices": vertices[a:b]})
    return found


def line_tensors(lines: VectorLines) -> dict[str, Any]:
    """The same as arrays; line_kinds are places in the order of `schemas.lines.LineKind`."""
    found = {"line_points": lines.points, "line_offsets": lines.offsets, "line_kinds": lines.kinds}
    found |= {"line_visible": lines.visible.astype(np.uint8), "line_closed": lines.closed.astype(np.uint8)}
    return found if lines.vertices is None else found | {"line_vertices": lines.vertices}


def lines_svg(lines: VectorLines, view: View, widths: Mapping[LineKind, float]) -> bytes:
    """A drawing, one group a kind, the silhouette's on top: hidden lines dashed in a path of their own. widths: pixels, where not usual."""
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{view.width}" height="{view.height}" viewBox="0 0 {view.width} {view.height}">\n'
        f"<title>Lines</title>\n<desc>{len(lines)} polylines, {int(lines.visible.sum())} of them visible</desc>\n"
        '<g fill="none" stroke-linecap="round" stroke-linejoin="round">\n'.encode()
    ]
    paths = [np.round(points, DRAWN_DIGITS) + 0.0 for points in lines.polylines()]
    for number in reversed(range(len(KINDS))):
        if (lines.kinds == number).any():
            parts += _group(lines, paths, number, widths)
    return b"".join([*parts, b"</g>\n</svg>\n"])


def _group(lines: VectorLines, paths: list[F8], number: int, widths: Mapping[LineKind, float]) -> Iterator[bytes]:
    kind = KINDS[number]
    color, usual, _ = LOOKS[kind]
    width = widths.get(kind, usual)
    yield f'<g class="{kind}" stroke="{color}" stroke-width="{width:g}">\n'.encode()
    for visible in (False, True):
        chosen = np.flatnonzero((lines.kinds == number) & (lines.visible == visible)).tolist()
        if chosen:
            look = '<path class="visible" d="'
            if not visible:
                dash, gap = (max(length, length * width) for length in DASH_PX)
                look = (
                    f'<path class="hidden" stroke-width="{HIDDEN_WIDTH * width:g}" stroke-opacity="{HIDDEN_OPACITY}" '
                    f'stroke-dasharray="{dash:g} {gap:g}" d="'
                )
            yield look.encode()
            yield from (b"M" + _points(paths[i]) + (b"Z" if lines.closed[i] else b"") for i in chosen)
            yield b'"/>\n'
    yield b"</g>\n"


def _points(points: F8) -> bytes:
    """`x,y x,y ...`: the JSON of the array without its brackets."""
    return orjson.dumps(points, option=orjson.OPT_SERIALIZE_NUMPY)[2:-2].replace(b"],[", b" ")


def lines_dxf(lines: VectorLines, view: View) -> bytes:
    """A DXF drawing of the image, a unit a pixel, y up: a layer a kind, and one for what of it is hidden, with dashes."""
    layers = sorted({(kind, visible) for kind, visible in zip(lines.kinds.tolist(), lines.visible.tolist(), strict=True)})
    corners = [(9, "$ACADVER"), (1, "AC1009"), (9, "$EXTMIN"), (10, 0.0), (20, 0.0), (30, 0.0)]
    corners += [(9, "$EXTMAX"), (10, float(view.width)), (20, float(view.height)), (30, 0.0)]
    tags = [*_section("HEADER", corners), *_section("TABLES", [*_line_types(), *_layers(layers)])]
    tags += [*_section("ENTITIES", _entities(lines, float(view.height))), (0, "EOF")]
    return "".join(f"{code:3d}\n{value}\n" for code, value in tags).encode("ascii")


Tag = tuple[int, object]
"""A group code and what it says."""


def _section(name: str, tags: list[Tag]) -> list[Tag]:
    return [(0, "SECTION"), (2, name), *tags, (0, "ENDSEC")]


def _line_types() -> list[Tag]:
    dash, gap = DASH_PX
    plain: list[Tag] = [(0, "LTYPE"), (2, "CONTINUOUS"), (70, 0), (3, "Solid line"), (72, 65), (73, 0), (40, 0.0)]
    dashes: list[Tag] = [(0, "LTYPE"), (2, "DASHED"), (70, 0), (3, "Dashed"), (72, 65), (73, 2), (40, dash + gap), (49, dash), (49, -gap)]
    return [(0, "TABLE"), (2, "LTYPE"), (70, 2), *plain, *dashes, (0, "ENDTAB")]


def _layers(layers: list[tuple[int, bool]]) -> list[Tag]:
    tags: list[Tag] = [(0, "TABLE"), (2, "LAYER"), (70, len(layers))]
    for kind, visible in layers:
        color, line_type = LOOKS[KINDS[kind]][2], "CONTINUOUS" if visible else "DASHED"
        tags += [(0, "LAYER"), (2, _layer(kind, visible)), (70, 0), (62, color), (6, line_type)]
    return [*tags, (0, "ENDTAB")]


def _layer(kind: int, visible: bool) -> str:
    return KINDS[kind].upper() + ("" if visible else "_HIDDEN")


def _entities(lines: VectorLines, height: float) -> list[Tag]:
    tags: list[Tag] = []
    each = zip(lines.polylines(), lines.kinds.tolist(), lines.visible.tolist(), lines.closed.tolist(), strict=True)
    for points, kind, visible, closed in each:
        layer = _layer(kind, visible)
        tags += [(0, "POLYLINE"), (8, layer), (66, 1), (10, 0.0), (20, 0.0), (30, 0.0), (70, int(closed))]
        for x, y in np.round(points, PIXEL_DIGITS).tolist():
            tags += [(0, "VERTEX"), (8, layer), (10, x), (20, round(height - y, PIXEL_DIGITS)), (30, 0.0)]
        tags += [(0, "SEQEND"), (8, layer)]
    return tags
