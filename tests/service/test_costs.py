from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from schemas.ladder import SIZES, Ladder
from schemas.render import Antialias, Source
from service.costs import NOMINAL, TERMS_OF, CostModel, ViewTerms, kind_of
from service.render.frame import FRAME
from service.rungs import SURFACE, passes_of
from tests.service.render.laddered import many_ways, with_ladder

VIEW = ViewTerms(area_px=50_000.0, image_px=512.0**2)


def model(**changed):
    return CostModel("a device", NOMINAL | changed)


def test_every_pass_of_every_rung_has_a_cost():
    for source, antialias in SURFACE:
        for name in passes_of(source, antialias):
            assert set(NOMINAL[kind_of(source, antialias, name)]) <= set(TERMS_OF[name])
    assert {step.name for step in FRAME} - {"smooth"} | {"frame"} == set(TERMS_OF)


def test_a_frame_costs_what_its_passes_cost():
    asset, costs = many_ways(), model()
    for number, rung in enumerate(asset.rungs.rungs):
        passes = costs.pass_ms(asset, number, ("frame", *passes_of(rung.source, rung.antialias)), VIEW)
        assert sum(passes.values()) == pytest.approx(costs.frame_ms(asset, number, VIEW), rel=1e-9)


def test_cost_grows_with_the_picture_and_with_how_far_a_level_is_beyond_the_mesh():
    asset, costs = many_ways(), model()
    leveled = next(n for n, rung in enumerate(asset.rungs.rungs) if rung.level == 0 and rung.antialias is Antialias.COVERAGE)
    for number in range(len(asset.rungs.rungs)):
        assert costs.frame_ms(asset, number, VIEW) < costs.frame_ms(asset, number, ViewTerms(4 * VIEW.area_px, 4 * VIEW.image_px))
    assert costs.frame_ms(asset, leveled, VIEW) < costs.frame_ms(asset, leveled, replace(VIEW, beyond_px=30.0))


@settings(deadline=None, max_examples=60)
@given(st.floats(0.4, 2.5), st.integers(0, 111), st.integers(5, 30))
def test_a_rung_that_takes_longer_or_shorter_is_predicted_so_after_a_few_frames(factor, number, frames):
    asset, costs = many_ways(), model()
    number %= len(asset.rungs.rungs)
    truth = factor * costs.frame_ms(asset, number, VIEW)
    for _ in range(frames):
        costs.observe(asset, number, VIEW, truth, None)
    assert costs.frame_ms(asset, number, VIEW) == pytest.approx(truth, rel=0.05)


def test_what_one_rung_teaches_moves_the_others_of_the_mesh_a_little_and_other_meshes_less():
    asset, other, costs = many_ways("knot"), many_ways("bumpy"), model()
    before = [costs.frame_ms(mesh, 0, VIEW) for mesh in (asset, other)]
    for _ in range(5):
        costs.observe(asset, 1, VIEW, 3.0 * costs.frame_ms(asset, 1, VIEW), None)
    for _ in range(2):
        costs.observe(other, 2, VIEW, costs.frame_ms(other, 2, VIEW), None)
    moved = [costs.frame_ms(mesh, 0, VIEW) / was for mesh, was in zip((asset, other), before, strict=True)]
    assert moved[0] > moved[1] > 1.0


def test_a_frame_that_the_machine_held_up_does_not_spoil_what_was_learnt():
    asset, costs = many_ways(), model()
    usual = costs.frame_ms(asset, 3, VIEW)
    for _ in range(10):
        costs.observe(asset, 3, VIEW, usual, None)
    costs.observe(asset, 3, VIEW, 1000.0 * usual, None)
    assert costs.frame_ms(asset, 3, VIEW) < 2.5 * usual
    for _ in range(5):
        costs.observe(asset, 3, VIEW, usual, None)
    assert costs.frame_ms(asset, 3, VIEW) == pytest.approx(usual, rel=0.1)


def test_edges_are_learnt_from_frames_of_the_meshs_own_outline():
    asset, costs = many_ways(), model()
    for _ in range(50):
        costs.observe(asset, 0, VIEW, costs.frame_ms(asset, 0, VIEW), 700)
    assert costs.terms(asset, VIEW)[1] == pytest.approx(700.0, rel=0.01)


@pytest.mark.parametrize("device", ["a device", "another"])
def test_times_of_a_ladder_are_of_its_device_only(device):
    asset = with_ladder(many_ways(), device=device)
    assert isinstance(asset.ladder, Ladder)
    costs, plain = model(), model()
    facts = asset.ladder.facts[-1]
    view = ViewTerms(facts.area_px, SIZES[-1] ** 2.0)
    ratios = []
    for number, rung in enumerate(asset.rungs.rungs):
        if rung.level is None:
            measured = np.exp(np.mean([np.log(at.frame.p50_ms) for at in asset.ladder.rungs[number].sizes]))
            ratios.append(costs.frame_ms(asset, number, view) / measured)
    spread = np.std(np.log(ratios))
    nominal = [plain.frame_ms(many_ways(), n, view) for n, rung in enumerate(asset.rungs.rungs) if rung.level is None]
    assert len(ratios) == len(nominal)
    assert (spread < 0.3) == (device == "a device")


def test_a_mesh_that_gains_rungs_keeps_what_was_learnt_of_it():
    asset, costs = many_ways(), model()
    for _ in range(20):
        costs.observe(asset, 0, VIEW, 2.0 * costs.frame_ms(asset, 0, VIEW), None)
    grown = replace(asset, other_hulls=())
    assert costs.frame_ms(grown, 0, VIEW) > 1.5 * model().frame_ms(grown, 0, VIEW)


def test_kinds_tell_the_same_pass_on_the_cpu_and_in_the_gl_apart():
    kinds = {kind_of(source, antialias, "surface") for source, antialias in SURFACE}
    assert kinds == {"cpu/surface", "clipped/surface", "original/surface"}
    assert kind_of(Source.CLIPPED, Antialias.NONE, "edges") == "edges"
