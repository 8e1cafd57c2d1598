"""The silhouette of one view as a document: JSON, an SVG drawing, or bare arrays.

Bulk numbers go from numpy through orjson, which is a hundred times faster than building models of them.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise
from typing import Any

import numpy as np
import orjson
from safetensors.numpy import save

from schemas.conventions import F8
from schemas.errors import InvalidRequestError
from service.silhouette.describe import Description, describe_silhouette
from service.silhouette.line_documents import line_tensors, lines_dxf, lines_json, lines_svg
from service.silhouette.outline import Outline

__all__ = ["Description", "describe_silhouette", "silhouette_binary", "silhouette_dxf", "silhouette_json", "silhouette_svg"]

PIXEL_DIGITS = 4
"""Decimals of pixel coordinates in JSON."""
DRAWN_DIGITS = 2
"""Decimals of pixel coordinates in drawings: a hundredth of a pixel."""
SURFACE, OUTLINE, LINES = "#e8e4da", "#1a1a1a", "#4a4a4a"
OUTLINE_PX, LINES_PX = 3.0, 0.7
"""The outline is drawn under the surface, which hides its inner half."""


def silhouette_json(described: Description) -> bytes:
    """The answer `schemas.render.Silhouette`; what was not asked for is left out.

    Pixels of vertices behind the eye are null; so would be anything else that is not a number.
    """
    answer: dict[str, Any] = {"eye": described.eye, "edge_count": len(described.edges), "edges": described.edges}
    if described.contours is not None:
        loops = described.contours
        answer["contours"] = [loops.vertices[a:b] for a, b in pairwise(loops.offsets)]
    if described.curves is not None:
        answer["curves"] = [np.round(curve, PIXEL_DIGITS) for curve in described.curves]
    if described.lines is not None:
        answer["lines"] = lines_json(described.lines)
    answer["surface"] = surface_of(described)
    vertices: dict[str, Any] = {}
    if described.positions is not None:
        vertices["position"] = described.positions
    if described.pixels is not None:
        vertices["pixel"] = np.round(described.pixels, PIXEL_DIGITS)
    answer["vertices"] = {"index": described.vertices, **vertices} if vertices else {}
    return orjson.dumps(answer, option=orjson.OPT_SERIALIZE_NUMPY)


def silhouette_binary(described: Description) -> bytes:
    """The safetensors layout, little-endian; what was not asked for is left out.

    edges: (s, 2) i4 directed vertex pairs. vertices: (k,) i4, the vertices used. contours: (s,) i4 vertices of closed loops, loop
    i is contours[offsets[i]:offsets[i + 1]]; offsets: (c + 1,) i4. positions: (k, 3) f8 of `vertices`, model units. pixels:
    (k, 2) f8 of `vertices`, y down, NaN behind the eye. curves: (n, 2) f8 pixels, closed cubic Bezier curves, each as node, two control
    points, node, ..., two control points; curve i is curves[curve_offsets[i]:curve_offsets[i + 1]], curve_offsets: (d + 1,) i4.
    line_points (n, 2) f8 pixels, line_offsets (l + 1,) i4, line_kinds, line_visible, line_closed (l,) u1, line_vertices (n,) i4: polylines;
    of strokes line_widths (n,) f8 pixels, line_opacities (n,) f8.
    The metadata's `eye` is four numbers as JSON text, its `surface` a `schemas.render.Surface`.
    """
    tensors: dict[str, Any] = {"edges": described.edges, "vertices": described.vertices}
    if described.contours is not None:
        tensors |= {"contours": described.contours.vertices, "offsets": described.contours.offsets}
    if described.positions is not None:
        tensors["positions"] = described.positions
    if described.pixels is not None:
        tensors["pixels"] = described.pixels
    if described.curves is not None:
        sizes = [len(curve) for curve in described.curves]
        tensors["curves"] = np.concatenate([np.empty((0, 2)), *described.curves])
        tensors["curve_offsets"] = np.cumsum([0, *sizes], dtype=np.int32)
    if described.lines is not None:
        tensors |= line_tensors(described.lines)
    eye = orjson.dumps(described.eye, option=orjson.OPT_SERIALIZE_NUMPY).decode()
    metadata = {"eye": eye, "surface": orjson.dumps(surface_of(described)).decode()}
    return bytes(save({name: np.ascontiguousarray(array) for name, array in tensors.items()}, metadata))


def surface_of(described: Description) -> dict[str, Any]:
    """`schemas.render.Surface`: what the silhouette is of."""
    level = described.level
    return {"level": level is not None, "faces": described.faces, "error_px": 0.0 if level is None else level.error_px}


def silhouette_svg(described: Description) -> bytes:
    """A drawing: the surface filled and outlined, with all silhouette lines over it, hidden ones too; or the lines asked for.

    One path of closed polygons in pixels, y down, rule "nonzero": it is filled where the winding number is not 0, that is where
    some front-facing layer is. Raises InvalidRequestError unless contours and an image (`project`) were asked for.
    """
    outline, view = described.outline, described.view
    if described.lines is not None and view is not None:
        return lines_svg(described.lines, view, described.line_widths)
    if outline is None or view is None:
        raise InvalidRequestError("a drawing needs contours and the size of its image", field="project")
    path = b"".join(_closed(outline))
    loops = 0 if described.contours is None else len(described.contours)
    text = (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{view.width}" height="{view.height}" viewBox="0 0 {view.width} {view.height}">\n'
        f"<title>Silhouette</title>\n<desc>{len(described.edges)} silhouette edges in {loops} contours</desc>\n"
        f'<g stroke-linejoin="round"><g fill="{SURFACE}" fill-rule="nonzero" stroke="{OUTLINE}" stroke-width="{OUTLINE_PX}" '
        'paint-order="stroke">\n<path id="silhouette" d="'
    )
    lines = f'"/></g>\n<use href="#silhouette" fill="none" stroke="{LINES}" stroke-width="{LINES_PX}"/></g>\n</svg>\n'
    return b"".join((text.encode(), path, lines.encode()))


def silhouette_dxf(described: Description) -> bytes:
    """The lines asked for as a DXF drawing. Raises InvalidRequestError where none were."""
    if described.lines is None or described.view is None:
        raise InvalidRequestError("a DXF drawing has lines: kinds must say which", field="kinds")
    return lines_dxf(described.lines, described.view)


def _closed(outline: Outline) -> Iterator[bytes]:
    """`M...Z` of every polygon; with `C` after the first point of one that is curved."""
    if outline.inner is None:
        yield from (b"M" + _points(polygon) + b"Z" for polygon in outline.polygons())
        return
    for curve in outline.curves():
        yield b"M" + _points(curve[:1]) + b"C" + _points(np.concatenate([curve[1:], curve[:1]])) + b"Z"


def _points(polygon: F8) -> bytes:
    """`x,y x,y ...`: the JSON of the rounded array without its brackets."""
    text = orjson.dumps(np.round(polygon, DRAWN_DIGITS) + 0.0, option=orjson.OPT_SERIALIZE_NUMPY)
    return text[2:-2].replace(b"],[", b" ")
