"""Lines of an image written down: parts of the JSON and binary answers, a drawing as SVG, and one as DXF.

The DXF is of release 12 (AutoCAD DXF Reference, POLYLINE, VERTEX, LAYER and LTYPE), which every reader knows; y is upwards there.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from itertools import pairwise
from typing import Any

import numpy as np
import orjson

from schemas.conventions import F8, I4
from schemas.lines import LineKind
from service.camera import View
from service.silhouette.line_mesh import Flags
from service.silhouette.lines import KINDS, VectorLines
from service.silhouette.strokes import HIDDEN_OPACITY, HIDDEN_WIDTH, dashed, opacity_levels, outlines_of

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
DASH_PX = (4.0, 3.0)
"""Of hidden lines: dash and gap."""
SHARE_DIGITS = 3
"""Decimals of widths and opacities."""


def drawn_widths(given: Mapping[LineKind, float]) -> dict[LineKind, float]:
    """Pixels of every kind in a drawing; given: where they are not the usual ones."""
    return {kind: given.get(kind, usual) for kind, (_, usual, _) in LOOKS.items()}


def lines_json(lines: VectorLines) -> list[dict[str, Any]]:
    """`schemas.render.Line` of each polyline, for orjson."""
    points = np.round(lines.points, PIXEL_DIGITS)
    flags = zip(lines.kinds.tolist(), lines.visible.tolist(), lines.closed.tolist(), strict=True)
    vertices = None if lines.vertices is None else [None if v < 0 else v for v in lines.vertices.tolist()]
    given: dict[str, Any] = {"vertices": vertices}
    for name, values in (("widths", lines.widths), ("opacities", lines.opacities)):
        given[name] = None if values is None else np.round(values, SHARE_DIGITS)
    columns = {name: values for name, values in given.items() if values is not None}
    found = []
    for (kind, visible, closed), (a, b) in zip(flags, pairwise(lines.offsets.tolist()), strict=True):
        line = {"kind": KINDS[kind], "visible": visible, "closed": closed, "points": points[a:b]}
        found.append(line | {name: values[a:b] for name, values in columns.items()})
    return found


def line_tensors(lines: VectorLines) -> dict[str, Any]:
    """The same as arrays; line_kinds are places in the order of `schemas.lines.LineKind`."""
    found = {"line_points": lines.points, "line_offsets": lines.offsets, "line_kinds": lines.kinds}
    found |= {"line_visible": lines.visible.astype(np.uint8), "line_closed": lines.closed.astype(np.uint8)}
    more = {"line_vertices": lines.vertices, "line_widths": lines.widths, "line_opacities": lines.opacities}
    return found | {name: values for name, values in more.items() if values is not None}


def lines_svg(lines: VectorLines, view: View, widths: Mapping[LineKind, float]) -> bytes:
    """A drawing, one group a kind, the silhouette's on top: hidden lines dashed in a path of their own. widths: pixels, where not usual."""
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{view.width}" height="{view.height}" viewBox="0 0 {view.width} {view.height}">\n'
        f"<title>Lines</title>\n<desc>{len(lines)} polylines, {int(lines.visible.sum())} of them visible</desc>\n"
        '<g fill="none" stroke-linecap="round" stroke-linejoin="round">\n'.encode()
    ]
    usual = drawn_widths(widths)
    for number, kind in reversed(list(enumerate(KINDS))):
        of_kind = lines.kinds == number
        if of_kind.any():
            parts.append(f'<g class="{kind}" stroke="{LOOKS[kind][0]}" stroke-width="{usual[kind]:g}">\n'.encode())
            for visible in (False, True):
                if (chosen := of_kind & (lines.visible == visible)).any():
                    parts += _paths(lines.chosen(chosen), kind, usual[kind], hidden=not visible)
            parts.append(b"</g>\n")
    return b"".join([*parts, b"</g>\n</svg>\n"])


def _paths(lines: VectorLines, kind: LineKind, width: float, *, hidden: bool) -> Iterator[bytes]:
    """Lines of one kind, all visible or all hidden: one path, or one for each level of opacity; filled where widths change."""
    filled, in_levels = lines.widths is not None, lines.opacities is not None
    own = HIDDEN_WIDTH * width if hidden else width
    look, gaps = f' stroke-width="{own:g}"' if hidden else "", ""
    if filled:
        look = f' stroke="none" fill="{LOOKS[kind][0]}"'
    if hidden:
        dash = np.array([max(length, length * width) for length in DASH_PX])
        if filled or in_levels:
            lines = dashed(lines, dash)
        else:
            gaps = f' stroke-dasharray="{dash[0]:g} {dash[1]:g}"'
    if not filled and lines.flat is not None and lines.flat.all():
        look += ' stroke-linecap="butt"'
    for opacity, level in opacity_levels(lines, HIDDEN_OPACITY if hidden and not in_levels else 1.0):
        blended = f' {"fill" if filled else "stroke"}-opacity="{opacity:.4g}"' if opacity < 1.0 else ""
        yield f'<path class="{"hidden" if hidden else "visible"}"{look}{blended}{gaps} d="'.encode()
        if filled:
            places, offsets = outlines_of(level, own)
            yield _path(places, offsets, np.ones(len(offsets) - 1, np.bool_))
        else:
            yield _path(level.points, level.offsets, level.closed)
        yield b'"/>\n'


def _path(points: F8, offsets: I4, closed: Flags) -> bytes:
    """`Mx,y x,y ...` of every polyline, with a `Z` if it is closed: the JSON of all points, rows of nulls standing for what is between."""
    if not len(closed):
        return b""
    between = np.where(closed[:-1, None], np.nan, (np.nan, 0.0))
    rows = np.insert(np.round(points, DRAWN_DIGITS) + 0.0, offsets[1:-1], between, axis=0)
    text = orjson.dumps(rows, option=orjson.OPT_SERIALIZE_NUMPY)[2:-2].replace(b"],[", b" ")
    return b"M" + text.replace(b" null,null ", b"ZM").replace(b" null,0.0 ", b"M") + (b"Z" if closed[-1] else b"")


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
    each = zip(lines.polylines(), lines.kinds.tolist(), lines.visible.tolist(), lines.closed.tolist(), _vertex_widths(lines), strict=True)
    for points, kind, visible, closed, widths in each:
        layer = _layer(kind, visible)
        tags += [(0, "POLYLINE"), (8, layer), (66, 1), (10, 0.0), (20, 0.0), (30, 0.0), (70, int(closed))]
        for (x, y), width in zip(np.round(points, PIXEL_DIGITS).tolist(), widths, strict=True):
            tags += [(0, "VERTEX"), (8, layer), (10, x), (20, round(height - y, PIXEL_DIGITS)), (30, 0.0), *width]
        tags += [(0, "SEQEND"), (8, layer)]
    return tags


def _vertex_widths(lines: VectorLines) -> Iterator[list[list[Tag]]]:
    """Of each polyline, for each vertex: widths at both ends of the piece that it begins; nothing where lines have no widths."""
    for a, b in pairwise(lines.offsets.tolist()):
        if lines.widths is None:
            yield [[]] * (b - a)
        else:
            widths = np.round(lines.widths[a:b], SHARE_DIGITS).tolist()
            yield [[(40, one), (41, other)] for one, other in zip(widths, [*widths[1:], widths[0]], strict=True)]
