from __future__ import annotations

import pytest

from schemas.errors import CapabilityError
from schemas.render import Accuracy, Antialias, RenderRequest, Shading, ShadingMode, Source
from service.costs import NOMINAL, CostModel
from service.render.explain import explain
from service.render.frame import FRAME, render_frame
from tests.service.render.laddered import many_ways
from tests.service.render.made import clippable, unclippable


def told(asset=None, mode="lambert", camera=None, **accuracy):
    more = {} if camera is None else {"camera": camera}
    request = RenderRequest(shading=Shading(mode=mode), accuracy=Accuracy(**accuracy), **more)
    return explain(request, asset or many_ways(), CostModel("a device", NOMINAL))


def test_every_pass_is_told_in_order_with_a_reason_and_a_cost_or_is_left_out_with_a_reason():
    order = [step.name for step in FRAME]
    for mode in ShadingMode:
        for antialias in Antialias:
            for source in (Source.AUTO, Source.ORIGINAL):
                report = told(mode=mode, antialias=antialias, source=source)
                names, left_out = [one.name for one in report.passes], [one.name for one in report.left_out]
                assert names == sorted(names, key=order.index)
                assert sorted(names + left_out, key=order.index) == order
                assert all(one.why for one in report.passes + report.left_out)
                assert all(one.predicted_ms > 0.0 for one in report.passes)
                assert report.predicted_ms >= sum(one.predicted_ms for one in report.passes) * 0.999


def test_what_is_told_is_what_is_drawn(gpu):
    for accuracy in (
        Accuracy(),
        Accuracy(antialias="msaa"),
        Accuracy(antialias="line", level=1),
        Accuracy(source="original"),
        Accuracy(smooth=True),
    ):
        request = RenderRequest(width=96, height=96, accuracy=accuracy)
        report, image = explain(request, many_ways(), gpu.costs), render_frame(gpu, many_ways(), request)
        assert tuple(one.name for one in report.passes if one.name in image.plan) == tuple(
            n for n in (s.name for s in FRAME) if n in image.plan
        )
        assert {one.name for one in report.passes} == set(image.plan)
        assert (report.rung, report.error_px) == (image.rung, image.error_px)


@pytest.mark.parametrize(
    ("accuracy", "says"),
    [
        ({}, "exact outline"),
        ({"source": "original"}, "asked for"),
        ({"antialias": "ssaa"}, "rung of the original"),
        ({"max_error_px": 2.0}, "fastest whose outline is within 2 px"),
        ({"max_error_px": 1e-4}, "no rung keeps 0.0001 px"),
        ({"budget_ms": 100.0}, "most accurate that is predicted to fit into 100 ms"),
        ({"budget_ms": 1e-3}, "no rung is predicted to fit into 0.001 ms"),
        ({"budget_ms": 50.0, "max_error_px": 0.5}, "of those that keep 0.5 px"),
    ],
)
def test_the_choice_has_a_reason(accuracy, says):
    assert says in told(**accuracy).why


def test_a_mesh_that_cannot_be_clipped_says_why():
    assert "boundary" in told(unclippable()).why
    with pytest.raises(CapabilityError):
        told(unclippable(), source="clipped")


def test_nothing_in_view_is_told_as_nothing():
    report = told(clippable("sphere"), camera={"eye": [0.0, 0.0, 9.0], "target": [0.0, 0.0, 20.0]})
    assert [one.name for one in report.passes] == ["background"]
    assert "in view" in report.why and {one.why for one in report.left_out} == {"nothing is in view"}
    assert report.predicted_ms < 0.1


def test_missed_wishes_are_listed():
    assert told(budget_ms=1e-3).missed == ["budget_ms"]
    assert told(max_error_px=1e-4, budget_ms=1e-3).missed == ["max_error_px", "budget_ms"]
