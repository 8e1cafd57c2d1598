from __future__ import annotations

import pytest

from schemas.errors import InvalidRequestError
from schemas.lines import LineMethod
from schemas.render import Fill, ImageFormat
from service.view_query import QUERY_NAMES, RenderQuery


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


@pytest.mark.parametrize(
    ("parameters", "field"),
    [
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
    for field in ("shading.fill", "shading.mode", "lines.charcoal", "lines.declutter", "lines.method"):
        assert field in QUERY_NAMES
