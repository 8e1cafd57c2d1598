from __future__ import annotations

import math
import statistics
import time
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from schemas.errors import CapabilityError, InvalidRequestError
from schemas.render import Accuracy, Antialias, Orbit, OrbitCamera, RenderRequest, Source
from service.camera import resolve_camera
from service.costs import NOMINAL, CostModel, ViewTerms
from service.render.choice import UNSEEN_PX
from service.render.plan import plan_frame, visible_area
from service.silhouette.levels import projected_px
from tests.service.render.laddered import many_ways, measured
from tests.service.render.made import clippable, seen_from, unclippable

OUTSIDE = np.array([3.0, 2.0, 4.0, 1.0])
INSIDE = np.array([0.1, 0.0, 0.0, 1.0])
FAST_GL = {name: of if "original" not in name else {"fixed": 1e-3} for name, of in NOMINAL.items()} | {
    name: {"fixed": 1e-3} for name in ("clear", "resolve", "read")
}
"""A device on which drawing the mesh costs next to nothing."""


def plan(asset=None, eye=OUTSIDE, side=512, costs=None, **accuracy):
    asset = asset or many_ways()
    return plan_frame(RenderRequest(accuracy=Accuracy(**accuracy)), asset, seen_from(asset, eye, side), costs)


def error_of(asset, view, number, size):
    rung = asset.rungs.rungs[number]
    beyond = 0.0 if rung.level is None else projected_px(view, asset.corners, asset.levels[rung.level].bound)
    return asset.rungs.alone_px[number, size] + beyond


def best_by_trying(asset, view, costs, accuracy):
    """Number of the best rung, from the rules as the API states them, one rung after the other."""
    table, size = asset.rungs, asset.rungs.nearest_size(math.sqrt(view.width * view.height))
    terms = ViewTerms(visible_area(asset, view).pixels, view.width * view.height)
    scale = projected_px(view, asset.corners, 1.0) if np.isfinite(projected_px(view, asset.corners, 1e-9)) else math.inf
    free = accuracy.budget_ms is not None or accuracy.min_psnr_db is not None
    found = []
    for number, rung in enumerate(table.rungs):
        error = error_of(asset, view, number, size)
        ms = costs.frame_ms(asset, number, replace(terms, beyond_px=error - table.alone_px[number, size]))
        if accuracy.source not in (Source.AUTO, rung.source) or accuracy.antialias not in (Antialias.AUTO, rung.antialias):
            continue
        if rung.hull is not None:
            shown = max(0, int(math.log2(max(1.0, table.hulls[rung.hull].density / scale)))) if scale < math.inf else 0
            shown = min(shown, table.hulls[rung.hull].most_halvings)
            if rung.halvings < shown or (not free and (rung.hull != 0 or rung.halvings != shown)):
                continue
        if not math.isfinite(error):
            continue
        psnr = table.psnr[number, size]
        broken = max(0.0, error - (accuracy.max_error_px or math.inf))
        short = max(0.0, (accuracy.min_psnr_db or 0.0) - psnr)
        over = max(0.0, ms - (accuracy.budget_ms or math.inf))
        rest = (ms, error, -psnr) if accuracy.budget_ms is None else (error, -psnr, ms)
        found.append(((broken, short, over, *rest), number))
    return min(found)[1]


ACCURACIES = st.builds(
    Accuracy,
    max_error_px=st.none() | st.floats(1e-3, 30.0),
    budget_ms=st.none() | st.floats(0.2, 20.0),
    min_psnr_db=st.none() | st.floats(15.0, 45.0),
    source=st.sampled_from([Source.AUTO, Source.CLIPPED, Source.ORIGINAL]),
    antialias=st.sampled_from([Antialias.AUTO, Antialias.COVERAGE, Antialias.NONE]),
).filter(lambda accuracy: accuracy.max_error_px is not None or accuracy.budget_ms is not None)


@settings(deadline=None, max_examples=200)
@given(ACCURACIES, st.booleans(), st.sampled_from([48, 200, 512, 1500]), st.floats(0.0, 360.0), st.sampled_from(["fit", 12.0, 40.0]))
def test_choice_is_the_one_that_trying_all_rungs_finds(accuracy, with_ladder, side, azimuth, distance):
    asset = measured() if with_ladder else many_ways()
    costs = CostModel("a device", NOMINAL)
    costs.of(asset)
    camera = OrbitCamera(orbit=Orbit(azimuth_deg=azimuth, elevation_deg=10.0, distance=distance))
    view = resolve_camera(camera, asset.frame, side, side, asset.radius)
    made = plan_frame(RenderRequest(accuracy=accuracy, camera=camera, width=side, height=side), asset, view, costs)
    assert made.choice.number == best_by_trying(asset, view, costs, accuracy)


@settings(deadline=None, max_examples=100)
@given(ACCURACIES, st.sampled_from([64, 512]))
def test_what_cannot_be_kept_is_said_and_nothing_else(accuracy, side):
    asset = measured()
    made = plan(asset, side=side, costs=CostModel("a device", NOMINAL), **accuracy.model_dump())
    choice, psnr = made.choice, asset.rungs.psnr[made.choice.number, asset.rungs.nearest_size(side)]
    missed = set()
    if accuracy.max_error_px is not None and choice.error_px > accuracy.max_error_px:
        missed.add("max_error_px")
    if accuracy.budget_ms is not None and choice.predicted_ms > accuracy.budget_ms:
        missed.add("budget_ms")
    if accuracy.min_psnr_db is not None and psnr < accuracy.min_psnr_db:
        missed.add("min_psnr_db")
    assert set(choice.missed) == missed


def test_nothing_asked_draws_the_exact_outline_over_the_hull_that_was_asked_for():
    choice = plan().choice
    assert (choice.rung.source, choice.rung.antialias, choice.rung.level, choice.rung.hull) == ("clipped", "coverage", None, 0)
    assert choice.missed == () and not choice.chosen


def test_both_bound_and_budget_the_bound_wins():
    tight = plan(max_error_px=0.1, budget_ms=1e-3)
    assert tight.error_px <= 0.1
    assert tight.choice.missed == ("budget_ms",)


def test_a_bound_that_nothing_keeps_gives_the_most_accurate_and_says_so():
    made = plan(max_error_px=1e-4)
    assert made.antialias is Antialias.COVERAGE and made.level is None
    assert made.choice.missed == ("max_error_px",)


def test_where_the_original_is_cheapest_it_is_drawn():
    fast = CostModel("fast", FAST_GL)
    assert plan(costs=fast, max_error_px=0.5).source is Source.ORIGINAL
    assert plan(costs=fast, budget_ms=100.0).source is Source.ORIGINAL
    assert plan(max_error_px=0.5, costs=CostModel("slow", NOMINAL | {"original/surface": {"fixed": 50.0}})).source is Source.CLIPPED


def test_a_larger_budget_is_never_less_accurate():
    slow_areas = {"coverage": {"fixed": 20.0}, "original/surface": {"fixed": 0.1, "samples": 5e-6}}
    costs, asset = CostModel("another", NOMINAL | slow_areas), measured()
    made = [plan(asset, costs=costs, budget_ms=ms).choice for ms in np.geomspace(0.3, 30.0, 30)]
    errors = [choice.error_px for choice in made if "budget_ms" not in choice.missed]
    assert len(set(errors)) > 1 and errors == sorted(errors, reverse=True)


def test_decibels_take_the_cheapest_hull_and_maps_that_have_them():
    asset, costs = measured(), CostModel("a device", NOMINAL)
    made = plan(asset, costs=costs, min_psnr_db=30.0).choice
    size = asset.rungs.nearest_size(512)
    assert made.error_px == plan(asset, costs=costs).choice.error_px
    assert asset.rungs.psnr[made.number, size] >= 30.0


def test_an_explicit_rung_is_drawn_as_it_is():
    asset = many_ways()
    for key in asset.rungs.keys:
        wanted = {"source": key.source, "antialias": key.antialias}
        if key.source is Source.CLIPPED:
            wanted |= {"level": -1 if key.level is None else key.level, "hull_faces": key.hull_faces, "texels": key.texels}
        assert asset.rungs.keys[plan(asset, **wanted).choice.number] == key


def test_a_level_the_mesh_has_not_is_refused():
    with pytest.raises(InvalidRequestError) as refused:
        plan(level=17)
    assert refused.value.where["field"] == "accuracy.level"


def test_what_cannot_be_clipped_has_bounds_and_budgets_of_the_original():
    for asset, eye in ((unclippable(), OUTSIDE), (many_ways(), INSIDE)):
        assert plan(asset, eye, max_error_px=0.2).rung == "original/ssaa"
        assert plan(asset, eye, max_error_px=0.8).rung == "original/none"
        assert plan(asset, eye, budget_ms=1e6).rung == "original/ssaa"
        with pytest.raises(CapabilityError):
            plan(asset, eye, source="clipped", budget_ms=5.0)


def test_bounds_say_what_they_rest_on():
    assert plan(antialias="coverage").choice.bound == "certified"
    assert plan(antialias="msaa").choice.bound == "nominal"
    made = plan(measured(), antialias="msaa")
    assert made.choice.bound == "measured"
    assert made.error_px == next(rung.sizes[-1].outline.distance_px for rung in measured().ladder.rungs if rung.antialias is Antialias.MSAA)


def test_a_level_that_no_pixel_can_tell_from_the_mesh_stands_for_it_unasked():
    asset = many_ways()
    far = np.array([0.0, 0.0, 90000.0, 1.0])
    made = plan(asset, far)
    assert made.level is not None and made.level.error_px <= UNSEEN_PX
    assert plan(asset, far, level=-1).level is None


def test_maps_are_no_finer_than_the_pixels_can_show():
    asset = many_ways()
    halvings = [plan(asset, side=side).halvings for side in (16, 64, 256, 1024, 4096)]
    assert halvings == sorted(halvings, reverse=True)
    assert halvings[0] > halvings[-1] == 0


def test_nothing_in_view_does_nothing_but_the_background():
    asset = clippable("sphere")
    camera = {"eye": [0.0, 0.0, 9.0], "target": [0.0, 0.0, 20.0]}
    request = RenderRequest(camera=camera)
    made = plan_frame(request, asset, resolve_camera(request.camera, asset.frame, 512, 512, asset.radius))
    assert made.passes == {"background"} and made.area.pixels == 0


def test_planning_takes_less_than_a_millisecond():
    asset, costs = measured(), CostModel("a device", NOMINAL)
    view, request = seen_from(asset, OUTSIDE), RenderRequest(accuracy=Accuracy(max_error_px=1.0, budget_ms=3.0, min_psnr_db=25.0))
    times = []
    for _ in range(300):
        start = time.perf_counter()
        plan_frame(request, asset, view, costs)
        times.append(time.perf_counter() - start)
    assert statistics.median(times) < 1e-3  # ten times the bar: the machine may be busy
