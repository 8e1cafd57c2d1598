from __future__ import annotations

from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from schemas.errors import InvalidRequestError
from schemas.ladder import AccuracyReport
from service.accuracy.pareto import front
from service.routes.documented import ACCURACY_EXAMPLE
from tests.service.accuracy.ladders import a_ladder, a_report
from tests.service.render.laddered import many_ways, with_ladder

NUMBERS = st.lists(st.tuples(st.sampled_from([0.0, 0.1, 0.2, 0.5, 1.0]), st.sampled_from([1.0, 2.0, 3.0, 5.0])), min_size=1, max_size=30)


@given(NUMBERS)
def test_front_is_what_no_other_point_beats(points):
    errors, times = [p[0] for p in points], [p[1] for p in points]
    best = front(errors, times)
    for i, point in enumerate(points):
        beaten = any(other != point and other[0] <= point[0] and other[1] <= point[1] for other in points)
        first = points.index(point) == i
        assert (i in best) == (not beaten and first)
    assert [times[i] for i in best] == sorted(times[i] for i in best)


def test_shading_front_holds_the_most_decibels_and_the_least_milliseconds():
    made = a_report()
    rungs = [made.rungs[n] for n in made.pareto.shading]
    assert rungs[0].ms == min(rung.ms for rung in made.rungs)
    assert rungs[-1].psnr_db == max(rung.psnr_db for rung in made.rungs)
    assert [rung.psnr_db for rung in rungs] == sorted(rung.psnr_db for rung in rungs)


def test_report_takes_the_nearest_measured_size_and_the_largest_without_one():
    assert a_report().size == 512
    assert a_report(size=1).size == 256
    assert a_report(size=300).size == 256
    assert a_report(size=5000).size == 512
    assert a_report().sizes == [256, 512]


def test_times_of_another_device_are_those_predicted_for_it():
    count = len(a_ladder().rungs)
    predicted = {"fast": {256: [1.0] * count, 512: [float(n) for n in range(count)]}}
    made = a_report(device="fast", predicted=predicted)
    assert made.devices == ["a device", "fast"]
    assert made.device == "fast"
    assert [rung.ms for rung in made.rungs] == [float(n) for n in range(count)]
    assert all(rung.ms_p95 is None and not rung.passes for rung in made.rungs)
    assert [rung.alpha_error for rung in made.rungs] == [rung.alpha_error for rung in a_report().rungs]


def test_measured_times_are_those_of_the_ladders_own_device_even_where_it_is_predicted():
    predicted = {"a device": {256: [9.0] * 100, 512: [9.0] * 100}}
    assert a_report(device="a device", predicted=predicted) == a_report()


def test_a_device_that_nothing_is_known_of_is_refused_with_those_that_are():
    with pytest.raises(InvalidRequestError, match="a device; fast") as refused:
        a_report(device="abacus", predicted={"fast": {}})
    assert refused.value.where["field"] == "device"


def test_report_survives_json():
    made = a_report()
    assert AccuracyReport.model_validate_json(made.model_dump_json(exclude_none=True)) == made


def test_documented_example_is_a_report():
    assert AccuracyReport.model_validate(ACCURACY_EXAMPLE).model_dump(exclude_none=True) == ACCURACY_EXAMPLE


def test_a_ladder_of_other_rungs_than_the_mesh_has_is_no_fault():
    fewer = replace(many_ways(), other_hulls=())
    asset = replace(fewer, ladder=with_ladder(many_ways()).ladder)
    assert asset.rungs.measured and len(asset.rungs.rungs) < len(asset.ladder.rungs)
