from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from schemas.errors import InvalidRequestError
from schemas.render import RenderRequest
from service.costs import NOMINAL, CostModel
from service.render.explain import explain
from service.render.frame import FRAME
from service.render.plan import drawn_there, plan_frame, shared_plan
from tests.service.render.made import bare, seen_from, unclippable

OUTSIDE, INSIDE = np.array([3.0, 2.0, 4.0, 1.0]), np.array([0.1, 0.0, 0.0, 1.0])
PLAIN = {"background", "clear", "surface", "resolve", "read", "composite"}


def plan(lines, asset=None, eye=OUTSIDE, **request):
    asset = asset or bare("sphere")
    return plan_frame(RenderRequest(lines=lines, **request), asset, seen_from(asset, eye))


def added(lines, **more):
    return plan(lines, **more).passes - PLAIN


def test_lines_are_drawn_on_the_original_with_samples():
    assert plan({"method": "wireframe"}).rung == "original/msaa"
    for antialias in ("none", "msaa", "ssaa"):
        assert plan({"method": "wireframe"}, accuracy={"antialias": antialias}).rung == f"original/{antialias}"
    assert plan({"method": "wireframe"}).error_px is None


def test_strokes_add_their_passes_and_leave_out_a_surface_that_nobody_sees():
    strokes = {"vector_lines", "line_strokes", "strokes"}
    assert added({"method": "strokes"}) == strokes
    assert added({"method": "strokes", "stroke": {"width_by": "depth"}}) == strokes
    assert added({"method": "strokes", "silhouette": None, "boundary": None}) == set()
    for fill in ("shaded", "white", "none"):
        assert ("surface" in plan({"method": "strokes"}, shading={"fill": fill}).passes) == (fill != "none")
    for stroke, resolved in (({}, False), ({"width_by": "depth"}, False), ({"opacity_by": "depth"}, True)):
        lines = {"method": "strokes", "stroke": stroke}
        assert ("resolve" in plan(lines, accuracy={"antialias": "none"}).passes) == resolved


def test_each_effect_adds_its_own_passes_and_no_other():
    strokes = {"line_faces", "line_strokes", "lines_back"}
    assert added({"method": "wireframe"}) == strokes
    assert added({"method": "fattened"}) == strokes
    assert added({"method": "translated"}) == {"line_faces", "lines_back"}
    assert added({"method": "fattened", "charcoal": True}) == strokes | {"charcoal"}
    assert added({"method": "fattened", "orientation": "any"}) == strokes | {"first_layer"}
    assert added({"method": "fattened", "silhouette": None}) == set()
    for kind in ("ridge", "valley"):
        assert added({"method": "fattened", "silhouette": None, kind: {}}) == {"line_strokes", "line_edges"}


def test_boundaries_are_drawn_only_where_there_are_any():
    assert "line_edges" not in added({"method": "wireframe"})
    assert "line_edges" in added({"method": "wireframe"}, asset=unclippable())
    assert "line_edges" not in added({"method": "wireframe", "boundary": None}, asset=unclippable())


def test_the_nearest_layer_is_looked_for_where_facing_does_not_tell():
    assert "first_layer" in added({"method": "fattened"}, asset=unclippable())
    assert "first_layer" in added({"method": "fattened"}, eye=INSIDE)


def test_a_picture_without_lines_has_none_of_their_passes():
    for asset in (bare("sphere"), unclippable()):
        assert not plan(None, asset=asset).passes & LINE_PASSES


LINE_PASSES = {"edge_mesh", "vector_lines", "strokes", "first_layer", "line_faces", "line_strokes", "charcoal", "lines_back", "line_edges"}


def test_translucent_lines_are_resolved_even_without_samples():
    style = {"opacity": 0.5}
    assert "resolve" in plan({"method": "wireframe", "silhouette": style}, accuracy={"antialias": "none"}).passes
    assert "resolve" not in plan({"method": "wireframe"}, accuracy={"antialias": "none"}).passes


@pytest.mark.parametrize(
    ("lines", "request_", "field"),
    [
        ({"method": "wireframe"}, {"accuracy": {"source": "clipped"}}, "accuracy.source"),
        ({"method": "wireframe"}, {"accuracy": {"antialias": "coverage"}}, "accuracy.antialias"),
        ({"method": "wireframe"}, {"accuracy": {"antialias": "line"}}, "accuracy.antialias"),
        ({"method": "wireframe"}, {"accuracy": {"smooth": True}}, "accuracy.smooth"),
        ({"method": "wireframe"}, {"accuracy": {"max_error_px": 1.0}}, "accuracy.max_error_px"),
        ({"method": "wireframe"}, {"accuracy": {"budget_ms": 1.0}}, "accuracy.budget_ms"),
        ({"method": "wireframe"}, {"accuracy": {"level": 0}}, "accuracy.level"),
        ({"method": "wireframe"}, {"shading": {"mode": "mask"}}, "shading.mode"),
        ({"method": "wireframe", "charcoal": True}, {}, "lines.charcoal"),
        ({"method": "translated", "declutter": True}, {}, "lines.declutter"),
        ({"method": "fattened", "pull": {"amount": 0.1}}, {}, "lines.pull"),
        ({"method": "edge_mesh", "stroke": {}}, {}, "lines.stroke"),
        ({"method": "wireframe", "stroke": {"dash": [3, 2]}}, {}, "lines.stroke"),
        ({"method": "strokes", "pull": {"amount": 0.1}}, {}, "lines.pull"),
        ({"method": "strokes", "scale": "distance"}, {}, "lines.scale"),
        ({"method": "strokes", "orientation": "any"}, {}, "lines.orientation"),
        ({"method": "strokes", "charcoal": True}, {}, "lines.charcoal"),
        ({"method": "translated", "pull": {"amount": 1.0}}, {}, "lines.pull.amount"),
        ({"method": "fattened", "charcoal": True}, {"shading": {"fill": "white"}}, "shading.fill"),
        (None, {"shading": {"fill": "white"}}, "shading.fill"),
    ],
)
def test_what_makes_no_sense_is_refused_by_its_field(lines, request_, field):
    with pytest.raises(InvalidRequestError) as caught:
        plan(lines, **request_)
    assert caught.value.where["field"] == field


def test_an_edge_mesh_is_one_pass_more_for_whatever_it_shows():
    assert added({}) == {"edge_mesh"}
    assert added({"method": "edge_mesh", "orientation": "any", "ridge": {"opacity": 0.5}}, asset=unclippable()) == {"edge_mesh"}


def test_lines_of_no_kind_take_no_pass():
    nothing = {"silhouette": None, "boundary": None}
    for method in ("edge_mesh", "fattened"):
        assert added({"method": method, **nothing}) == set()
        assert not plan({"method": method, **nothing}).deep


NEARBY = seen_from(bare("sphere"), OUTSIDE)


def test_a_target_that_meshes_share_has_what_one_of_them_needs():
    plans = [plan(None, accuracy={"source": "original", "antialias": "none"})]
    assert not shared_plan(plans, NEARBY).deep
    plans += [plan(lines, accuracy={"antialias": "none"}) for lines in ({}, {"method": "wireframe", "silhouette": {"opacity": 0.5}})]
    shared = shared_plan(plans, NEARBY)
    assert (shared.deep, shared.marked) == (True, True)
    assert shared.passes >= {"edge_mesh", "lines_back", "resolve"}
    there = [drawn_there(one, shared) for one in plans]
    assert all(one.deep and "resolve" in one.passes for one in there)
    assert [one.marked for one in there] == [False, False, True]
    assert "lines_back" not in there[1].passes


def test_depth_is_in_floats_where_meshes_are_near_and_far_and_lines_ask_for_it():
    wide, flat = replace(NEARBY, near=1e-4 * NEARBY.far), replace(NEARBY, eye=np.array([0.0, 0.0, 1.0, 0.0]), near=1e-4 * NEARBY.far)
    lined, plain = plan({}, accuracy={"antialias": "none"}), plan(None, accuracy={"source": "original", "antialias": "none"})
    assert [shared_plan([lined, plain], view).deep for view in (NEARBY, wide, flat)] == [False, True, False]
    assert not shared_plan([plain, plain], wide).deep


def test_the_area_holds_what_lines_have_beyond_the_mesh():
    narrow, wide = (plan({"method": "fattened", "silhouette": {"width": width}}).area for width in (1.0, 60.0))
    assert wide.width >= narrow.width + 2 * 58
    still, wobbling = (plan({"method": "strokes", "stroke": {"wobble_px": reach}}).area for reach in (0.0, 30.0))
    assert wobbling.width >= still.width + 2 * 29


def test_plans_with_lines_are_told_with_a_reason_and_a_cost_for_every_pass():
    order = [step.name for step in FRAME]
    for lines in (
        {"method": "translated"},
        {"method": "fattened", "charcoal": True, "orientation": "any", "ridge": {}},
        {"method": "strokes"},
    ):
        report = explain(RenderRequest(lines=lines), bare("sphere"), CostModel("a device", NOMINAL))
        names, left_out = [one.name for one in report.passes], [one.name for one in report.left_out]
        assert sorted(names + left_out, key=order.index) == order
        assert all(one.why for one in report.passes + report.left_out)
        assert all(one.predicted_ms > 0.0 for one in report.passes)
        assert "original" in report.why
