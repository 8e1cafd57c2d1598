"""The ladder of a small mesh, against one whose every rung is measured by itself."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from schemas.ladder import Ladder, RungKey
from schemas.render import Antialias, RenderRequest, Source
from service.measure.errors import outline_error, outline_of, shading_error, shading_of
from service.measure.ladder import explicit, measure_step, put_together, steps
from service.measure.reference import reference
from service.measure.views import spread_view
from service.render.frame import render_frame
from service.rungs import CERTIFIED
from tests.service.render.laddered import many_ways
from tests.service.render.made import unclippable
from tests.service.render.test_level_frames import swollen

pytestmark = pytest.mark.xdist_group("ladder")  # one process measures for all tests

VIEWS, SIZES = 3, (48, 96)


@cache
def measured(gpu, asset_of):
    asset = asset_of()
    views = [measure_step(gpu, asset, step, VIEWS) for step in steps(VIEWS, SIZES)]
    return asset, views, put_together(asset, gpu.costs.device, views, VIEWS)


@cache
def pictures(gpu, size):
    """Of each rung in each view, and the references of the views."""
    asset = many_ways()
    cameras = [spread_view(view, VIEWS) for view in range(VIEWS)]
    drawn = {}
    for number, key in enumerate(asset.rungs.keys):
        accuracy = explicit(asset.rungs, number)
        asked = [RenderRequest(camera=camera, width=size, height=size, accuracy=accuracy) for camera in cameras]
        drawn[key] = [render_frame(gpu, asset, request) for request in asked]
    return drawn, [reference(gpu, asset, camera, size) for camera in cameras]


def key_of(rung):
    return RungKey(**rung.model_dump(include=set(RungKey.model_fields)))


def test_every_rung_is_there_once_with_every_size(gpu):
    asset, _, ladder = measured(gpu, many_ways)
    assert tuple(key_of(rung) for rung in ladder.rungs) == asset.rungs.keys
    assert all([at.size for at in rung.sizes] == [48, 96] for rung in ladder.rungs)
    assert (ladder.views, ladder.samples) == (3, 16)
    assert Ladder.model_validate_json(ladder.model_dump_json()) == ladder
    levels = {rung.level: rung.level_faces for rung in ladder.rungs}
    assert levels == {None: len(asset.faces)} | {number: len(level.faces) for number, level in enumerate(asset.levels)}


@pytest.mark.parametrize("number", [0, 1])
def test_outline_errors_are_those_of_each_rungs_own_pictures(gpu, number):
    _, _, ladder = measured(gpu, many_ways)
    drawn, references = pictures(gpu, SIZES[number])
    for rung in ladder.rungs:
        pairs = zip(drawn[key_of(rung)], references, strict=True)
        assert rung.sizes[number].outline == outline_error([outline_of(image.pixels, true) for image, true in pairs]), rung.label


@pytest.mark.parametrize("number", [0, 1])
def test_shading_errors_are_those_of_each_rungs_own_colours(gpu, number):
    _, _, ladder = measured(gpu, many_ways)
    drawn, references = pictures(gpu, SIZES[number])
    for rung in ladder.rungs:
        key = key_of(rung)
        if key.source is Source.CLIPPED:
            key = key.model_copy(update={"antialias": Antialias.COVERAGE, "level": None})
        # which pixels a rung fills is a matter of its outline
        own = [
            np.dstack([image.pixels[..., :3], exact.pixels[..., 3]]) for image, exact in zip(drawn[key_of(rung)], drawn[key], strict=True)
        ]
        found = shading_error([shading_of(pixels, true) for pixels, true in zip(own, references, strict=True)])
        # the CPU and the GL round colours differently
        assert rung.sizes[number].shading.psnr_db == pytest.approx(found.psnr_db, abs=0.05), rung.label
        assert rung.sizes[number].shading.ssim == pytest.approx(found.ssim, abs=0.001), rung.label


def test_shading_tells_hulls_apart_by_more_than_what_differs_between_their_rungs(gpu):
    _, _, ladder = measured(gpu, many_ways)
    texels = [rung.texels for rung in ladder.rungs if rung.hull_faces is not None]
    full = [rung for rung in ladder.rungs if rung.hull_faces is not None and rung.texels > 0.6 * max(texels)]
    psnr = {rung.hull_faces: rung.sizes[1].shading.psnr_db for rung in full}
    assert len(psnr) == 3 and sorted(psnr, key=psnr.__getitem__) == sorted(psnr)
    assert min(np.diff(sorted(psnr.values()))) > 0.5


@pytest.mark.parametrize("antialias", ["line", "coverage"])
def test_alpha_is_the_same_whichever_hull_is_drawn(gpu, antialias):
    drawn, _ = pictures(gpu, 96)
    by_level = {}
    for key, images in drawn.items():
        if key.source is Source.CLIPPED and key.antialias is Antialias(antialias):
            by_level.setdefault(key.level, []).append([image.pixels[..., 3] for image in images])
    assert len(by_level) > 1 and all(len(same) >= 3 for same in by_level.values())
    assert all(np.array_equal(same[0], other) for same in by_level.values() for other in same[1:])


def test_without_antialiasing_a_level_ends_where_the_hull_does_so_each_hull_is_measured(gpu):
    _, _, ladder = measured(gpu, many_ways)
    none = [rung for rung in ladder.rungs if rung.source is Source.CLIPPED and rung.antialias is Antialias.NONE]
    exact = [rung.sizes[1].outline for rung in none if rung.level is None]
    assert all(outline == exact[0] for outline in exact)
    coarsest = max(rung.level for rung in none if rung.level is not None)
    assert len({rung.sizes[1].outline.wrong_pixels for rung in none if rung.level == coarsest}) > 1


def test_certified_bounds_hold_for_what_was_measured(gpu):
    _, views, ladder = measured(gpu, many_ways)
    for rung in ladder.rungs:
        for size, at in zip(SIZES, rung.sizes, strict=True):
            assert (at.bound_px is not None) == (rung.antialias in CERTIFIED)
            if at.bound_px is not None:
                # distances are between centres of pixels, each half a diagonal from its corners; samples are a sixteenth apart
                assert at.outline.distance_px <= at.bound_px + 2**0.5 + 1 / 16
                assert at.bound_px in [one.bound_px for view in views if view.size == size for one in view.rungs.values()]


def test_coverage_is_nearer_to_the_reference_than_any_other_antialiasing(gpu):
    _, _, ladder = measured(gpu, many_ways)
    own = {(rung.source, rung.antialias): rung.sizes[1].outline.alpha_error for rung in ladder.rungs if rung.level is None}
    exact = own.pop((Source.CLIPPED, Antialias.COVERAGE))
    assert own.pop((Source.ORIGINAL, Antialias.COVERAGE)) == exact <= 0.015
    assert all(exact < error for error in own.values())


def test_times_are_those_of_frames_and_their_passes(gpu):
    _, views, ladder = measured(gpu, many_ways)
    drawn, _ = pictures(gpu, 48)
    for rung in ladder.rungs:
        at = rung.sizes[0]
        assert set(at.passes) == set(drawn[key_of(rung)][0].plan)
        assert 0.0 < at.frame.p50_ms <= at.frame.p95_ms
    for view in views:
        assert all(0.0 < sum(rung.passes.values()) <= rung.ms for rung in view.rungs.values())


def test_facts_are_of_the_mesh_in_its_own_outline(gpu):
    asset, _, ladder = measured(gpu, many_ways)
    drawn, _ = pictures(gpu, 96)
    images = drawn[next(key for key in asset.rungs.keys if key.antialias is Antialias.COVERAGE and key.level is None)]
    assert ladder.facts[1].silhouette_edges == np.median([image.edges for image in images])
    assert ladder.facts[1].area_px == np.median([image.planned.area.pixels for image in images])
    assert ladder.facts[0].area_px < ladder.facts[1].area_px


def test_a_mesh_that_cannot_be_clipped_has_rungs_of_the_original(gpu):
    _, _, ladder = measured(gpu, unclippable)
    assert [rung.label for rung in ladder.rungs] == ["original/none", "original/msaa", "original/ssaa"]
    assert ladder.facts[0].silhouette_edges == 0


def test_a_rung_that_only_some_views_are_drawn_on_is_left_out(gpu):
    # nothing can be said of so far a level in the nearer views
    far = replace(swollen("bumpy", 2.4), id="a level nearly out of bounds")
    views = [measure_step(gpu, far, step, VIEWS) for step in steps(VIEWS, SIZES)]
    assert len({len(view.rungs) for view in views}) == 2
    ladder = put_together(far, "device", views, VIEWS)
    assert {rung.level for rung in ladder.rungs} == {None}
    assert len(ladder.rungs) == min(len(view.rungs) for view in views)
