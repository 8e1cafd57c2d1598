from __future__ import annotations

import pytest

from schemas.errors import InvalidRequestError
from schemas.lines import LineMethod, Stroke
from schemas.render import Fill, ImageFormat
from service.view_query import QUERY_NAMES, RenderQuery, SilhouetteQuery


def asked(**parameters):
    return RenderQuery(**parameters).request(ImageFormat.PNG)


def test_lines_are_absent_unless_a_method_is_named():
    assert asked().lines is None


def test_a_method_alone_draws_silhouette_and_boundaries():
    lines = asked(lines="fattened").lines
    assert lines is not None and lines.method is LineMethod.FATTENED
    assert lines.silhouette is not None and lines.boundary is not None
    assert lines.ridge is None and lines.valley is None


def test_looks_and_kinds_are_those_of_the_address():
    wanted = asked(lines="wireframe", line_kinds="ridge, silhouette", line_width=2.5, line_color="102030", line_opacity=0.5, fill="white")
    lines = wanted.lines
    assert lines is not None and lines.silhouette == lines.ridge is not None
    assert (lines.silhouette.width, lines.silhouette.color, lines.silhouette.opacity) == (2.5, "#102030", 0.5)
    assert lines.boundary is None and lines.valley is None
    assert wanted.shading.fill is Fill.WHITE


def test_strokes_are_asked_for_by_any_of_their_parameters():
    assert asked(lines="strokes").lines.stroke is None
    stroke = asked(lines="strokes", stroke_width_by="depth", stroke_dash="12,6", stroke_seed=3, stroke_wobble_px=2.5).lines.stroke
    assert (stroke.width_by, stroke.dash, stroke.seed, stroke.wobble_px, stroke.opacity_by) == ("depth", [12.0, 6.0], 3, 2.5, None)
    drawing = SilhouetteQuery(kinds="silhouette", stroke_opacity_by="angle", stroke_nib_deg=30, stroke_least=0.5).request().stroke
    assert (drawing.opacity_by, drawing.nib_deg, drawing.least) == ("angle", 30.0, 0.5)
    assert SilhouetteQuery(kinds="silhouette").request().stroke is None


def test_every_field_of_a_stroke_has_a_parameter():
    for query in (RenderQuery, SilhouetteQuery):
        assert {f"stroke_{name}" for name in Stroke.model_fields} <= set(query.model_fields)


@pytest.mark.parametrize(
    ("parameters", "field"),
    [
        ({"lines": "strokes", "stroke_dash": "12"}, "stroke_dash"),
        ({"lines": "strokes", "stroke_dash": "12,long"}, "stroke_dash"),
        ({"lines": "strokes", "stroke_dash": "12,0.1"}, "stroke_dash"),
        ({"lines": "strokes", "stroke_least": 2.0}, "stroke_least"),
        ({"stroke_wobble_px": 2.0}, "stroke_wobble_px"),
        ({"line_width": 2.0}, "line_width"),
        ({"charcoal": True}, "charcoal"),
        ({"lines": "wireframe", "line_kinds": "crease"}, "line_kinds"),
        ({"lines": "wireframe", "line_width": 65.0}, "line_width"),
        ({"lines": "wireframe", "line_color": "red"}, "line_color"),
    ],
)
def test_faults_are_told_by_the_name_in_the_address(parameters, field):
    with pytest.raises(InvalidRequestError) as caught:
        asked(**parameters)
    told = caught.value.where.get("field") or next(error["field"] for error in caught.value.where["errors"])
    assert told == field


def test_fields_that_plans_refuse_have_names_in_the_address():
    for field in (
        "shading.fill",
        "shading.mode",
        "lines.charcoal",
        "lines.declutter",
        "lines.method",
        "lines.stroke",
        "lines.scale",
        "stroke",
    ):
        assert field in QUERY_NAMES
