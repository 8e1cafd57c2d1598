from __future__ import annotations

import xml.etree.ElementTree as ET
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from schemas.errors import InvalidRequestError
from schemas.ladder import AccuracyReport
from service.accuracy.pareto import front
from service.accuracy.plot import STYLES, accuracy_svg
from service.accuracy.report import accuracy_report
from service.rungs import SURFACE
from tests.service.render.laddered import many_ways, measured, with_ladder

NUMBERS = st.lists(st.tuples(st.sampled_from([0.0, 0.1, 0.2, 0.5, 1.0]), st.sampled_from([1.0, 2.0, 3.0, 5.0])), min_size=1, max_size=30)


def report(size=None, device=None, predicted=None, name="knot.ply"):
    return accuracy_report("0" * 32, name, measured().ladder, size, device, predicted or {})


@given(NUMBERS)
def test_front_is_what_no_other_point_beats(points):
    errors, times = [p[0] for p in points], [p[1] for p in points]
    best = front(errors, times)
    for i, point in enumerate(points):
        beaten = any(other != point and other[0] <= point[0] and other[1] <= point[1] for other in points)
        first = points.index(point) == i
        assert (i in best) == (not beaten and first)
    assert [times[i] for i in best] == sorted(times[i] for i in best)


def test_report_takes_the_nearest_measured_size_and_the_largest_without_one():
    assert report().size == 512
    assert report(size=1).size == 256
    assert report(size=300).size == 256
    assert report(size=5000).size == 512
    assert report().sizes == [256, 512]


def test_times_of_another_device_are_those_predicted_for_it():
    count = len(measured().ladder.rungs)
    predicted = {"fast": {256: [1.0] * count, 512: [float(n) for n in range(count)]}}
    made = report(device="fast", predicted=predicted)
    assert made.devices == ["a device", "fast"] and made.device == "fast"
    assert [rung.ms for rung in made.rungs] == [float(n) for n in range(count)]
    assert all(rung.ms_p95 is None and not rung.passes for rung in made.rungs)
    assert [rung.alpha_error for rung in made.rungs] == [rung.alpha_error for rung in report().rungs]


def test_a_device_that_nothing_is_known_of_is_refused_with_those_that_are():
    with pytest.raises(InvalidRequestError, match="a device") as refused:
        report(device="abacus")
    assert refused.value.where["field"] == "device"


def test_plot_is_well_formed_and_shows_every_rung_with_its_numbers():
    made = report(name="a <knot> & co.ply")
    root = ET.fromstring(accuracy_svg(made))
    titles = [node.text for node in root.iter("{http://www.w3.org/2000/svg}title")]
    assert len(titles) == 2 * len(made.rungs)
    assert all(sum(title.startswith(f"{rung.name}: ") for title in titles) >= 2 for rung in made.rungs)
    assert any("a <knot> & co.ply" in (node.text or "") for node in root.iter())
    assert {f"{source.value}/{antialias.value}" for source, antialias in SURFACE} == set(STYLES)


def test_plot_stays_inside_its_card():
    root = ET.fromstring(accuracy_svg(report()))
    width, height = float(root.get("width")), float(root.get("height"))
    for node in root.iter("{http://www.w3.org/2000/svg}circle"):
        assert 0.0 < float(node.get("cx")) < width and 0.0 < float(node.get("cy")) < height
    for node in root.iter("{http://www.w3.org/2000/svg}text"):
        assert 0.0 < float(node.get("x")) < width and 0.0 < float(node.get("y")) < height


def test_plot_of_an_exact_and_of_a_single_rung_can_be_drawn():
    ladder = measured().ladder
    exact = (
        ladder.rungs[0].sizes[-1].model_copy(update={"outline": ladder.rungs[0].sizes[-1].outline.model_copy(update={"alpha_error": 0.0})})
    )
    alone = ladder.model_copy(update={"rungs": [ladder.rungs[0].model_copy(update={"sizes": [ladder.rungs[0].sizes[0], exact]})]})
    made = accuracy_report("0" * 32, "one", alone, None, None, {})
    assert made.pareto.outline == made.pareto.shading == [0]
    ET.fromstring(accuracy_svg(made))


def test_report_survives_json():
    made = report()
    assert AccuracyReport.model_validate_json(made.model_dump_json(exclude_none=True)) == made


def test_a_ladder_of_other_rungs_than_the_mesh_has_is_no_fault():
    fewer = replace(many_ways(), other_hulls=())
    asset = replace(fewer, ladder=with_ladder(many_ways()).ladder)
    assert asset.rungs.measured and len(asset.rungs.rungs) < len(asset.ladder.rungs)
