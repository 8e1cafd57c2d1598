"""What lines in a picture ask of it: the rung, the passes, and how far they reach beyond the mesh."""

from __future__ import annotations

import math

from schemas.errors import InvalidRequestError
from schemas.lines import LineKind, LineMethod, Lines, LineStyle
from schemas.render import Accuracy, Antialias, Fill, RenderRequest, ShadingMode, Source
from service.assets import MeshAsset
from service.camera import View

OF_HULLS = ("max_error_px", "budget_ms", "min_psnr_db", "level", "hull_faces", "texels")
"""Fields of `accuracy` that choose among ways to draw a hull, or between that and the mesh."""
LINE_PASSES = ("first_layer", "line_faces", "vector_lines", "line_strokes", "charcoal", "lines_back", "line_edges", "edge_mesh", "strokes")
"""Passes that only lines have, in order."""
DEEP_PASSES = frozenset(LINE_PASSES) - {"edge_mesh"}
"""Those that compare depths of lines and surfaces, so that these must be told apart at any distance."""
DRAWN_KINDS = (LineKind.SILHOUETTE, LineKind.BOUNDARY, LineKind.RIDGE, LineKind.VALLEY)
"""Kinds that pictures have; the first of several that a line is counts."""
SAMPLED = (Antialias.NONE, Antialias.MSAA, Antialias.SSAA)


def lines_asked(request: RenderRequest) -> Lines | None:
    """The lines of a request, if any. Raises InvalidRequestError, with the field, where they or what else it says make no sense."""
    lines, shading = request.lines, request.shading
    if lines is None:
        if shading.fill is not Fill.SHADED:
            raise InvalidRequestError("shading.fill is what lies under lines: it needs lines", field="shading.fill")
        return None
    if shading.mode is ShadingMode.MASK:
        raise InvalidRequestError("a mask has no lines in it: take fill none for lines alone", field="shading.mode")
    if lines.method is not LineMethod.FATTENED:
        for field in ("charcoal", "declutter"):
            if getattr(lines, field):
                raise InvalidRequestError(f"{field} belongs to the method fattened", field=f"lines.{field}")
    elif lines.pull.amount is not None:
        raise InvalidRequestError("fattened faces are not pulled: pull belongs to wireframe and translated", field="lines.pull")
    _check_strokes(lines)
    if lines.pull.by == "z" and lines.pull.amount is not None and lines.pull.amount >= 1.0:
        raise InvalidRequestError("a pull by z is a share of the distance, below 1", field="lines.pull.amount")
    if lines.charcoal and shading.fill is not Fill.SHADED:
        raise InvalidRequestError("charcoal has a shading of its own: fill must be shaded", field="shading.fill")
    return lines


def _check_strokes(lines: Lines) -> None:
    """Raise InvalidRequestError where something does not go with strokes, or a stroke is asked of another method."""
    if lines.method is not LineMethod.STROKES:
        if lines.stroke is not None:
            raise InvalidRequestError("a stroke is how the lines of the method strokes change along themselves", field="lines.stroke")
        return
    if lines.pull.amount is not None:
        raise InvalidRequestError("strokes are not pulled: pull belongs to wireframe and translated", field="lines.pull")
    if lines.scale == "distance":
        raise InvalidRequestError("the width of strokes follows the distance by stroke.width_by depth", field="lines.scale")
    if lines.orientation == "any":
        raise InvalidRequestError("strokes are found by facing: faces turned any way need another method", field="lines.orientation")


def lined(accuracy: Accuracy) -> Accuracy:
    """What lines leave of an accuracy: the original with samples. Raises InvalidRequestError for what only other ways of drawing have."""
    if accuracy.source is Source.CLIPPED:
        raise InvalidRequestError("lines are drawn on the original mesh", field="accuracy.source")
    if accuracy.antialias not in (*SAMPLED, Antialias.AUTO):
        raise InvalidRequestError("lines are smoothed by samples: none, msaa or ssaa", field="accuracy.antialias")
    if accuracy.smooth:
        raise InvalidRequestError("a smooth outline has no lines", field="accuracy.smooth")
    for field in OF_HULLS:
        if getattr(accuracy, field) is not None:
            raise InvalidRequestError(f"lines are drawn on the original mesh: no {field} goes with them", field=f"accuracy.{field}")
    antialias = Antialias.MSAA if accuracy.antialias is Antialias.AUTO else accuracy.antialias
    return Accuracy(source=Source.ORIGINAL, antialias=antialias)


def line_passes(lines: Lines, asset: MeshAsset, closed: bool) -> frozenset[str]:
    """Passes that the lines add. closed: the nearest layer is the front faces; otherwise it is looked for."""
    if lines.method is LineMethod.EDGE_MESH:
        return frozenset({"edge_mesh"} if styles_of(lines) else ())
    if lines.method is LineMethod.STROKES:
        drawn = {"vector_lines", "line_strokes", "strokes"} if styles_of(lines) else set()
        return frozenset(drawn | ({"resolve"} if is_translucent(lines) else set()))
    passes: set[str] = set()
    if lines.silhouette is not None:
        passes |= {"line_faces", "lines_back"} | ({"line_strokes"} if lines.method is not LineMethod.TRANSLATED else set())
    if lines.charcoal:
        passes |= {"line_faces", "line_strokes", "charcoal"}
    ends = lines.boundary is not None and asset.edges is None
    if ends or lines.ridge is not None or lines.valley is not None:
        passes |= {"line_strokes", "line_edges"}
    if "line_faces" in passes and not closed:
        passes.add("first_layer")
    if is_translucent(lines):
        passes.add("resolve")
    return frozenset(passes)


def is_deep(passes: frozenset[str]) -> bool:
    """Whether depth must be in floats for them, and reversed."""
    return bool(passes & DEEP_PASSES)


def is_translucent(lines: Lines) -> bool:
    """Whether some lines are blended with what is behind them."""
    if lines.stroke is not None and lines.stroke.opacity_by is not None:
        return True
    return any(style.opacity < 1.0 for style in styles_of(lines))


def styles_of(lines: Lines) -> list[LineStyle]:
    """The styles of the kinds that are drawn."""
    return [style for style in (lines.silhouette, lines.boundary, lines.ridge, lines.valley) if style is not None]


def reach_px(lines: Lines, view: View) -> int:
    """Pixels by which lines may leave the mesh in the image, at most its width and height."""
    width = max((style.width for style in styles_of(lines)), default=0.0)
    if lines.stroke is not None:
        width += lines.stroke.wobble_px
    if lines.scale == "distance" and not view.orthographic:
        width *= max(1.0, reference_depth(view) / view.near)
    return math.ceil(min(width, float(view.width + view.height)))


def reference_depth(view: View) -> float:
    """w of the middle of all that is drawn, where lines that scale with distance have their width; at least that of the near plane."""
    return max(float(view.matrix[3, 3]) if view.middle_depth is None else view.middle_depth, view.near)
