"""Pictures whose outline is a level's: within the promise, coloured everywhere, exact where nothing is asked."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from geometry.topology import build_edges
from schemas.errors import CapabilityError, InvalidRequestError
from schemas.render import Accuracy, RenderRequest, Shading
from service.camera import resolve_camera
from service.costs import CostModel
from service.render.frame import render_frame
from service.render.plan import plan_frame
from service.silhouette.levels import SilhouetteLevel, projected_px
from tests.service.render.conftest import VIEWS
from tests.service.render.made import clippable, grown, quiet
from worker.distance import DistanceTo
from worker.hull import build_hull
from worker.levels import build_levels


@cache
def leveled(name):
    """A shape with the levels that the preprocessing makes."""
    asset = clippable(name)
    hull = build_hull(asset.positions, asset.faces, 200, quiet)
    made = build_levels(asset.positions, asset.faces, (hull.step_vertices, hull.step_positions), len(hull.faces), quiet)
    assert made
    return replace(asset, levels=tuple(SilhouetteLevel(level.tensors(), level.tree.tensors()) for level in made))


@cache
def swollen(name, factor=1.15):
    """A shape whose one level lies far outside of its drawn hull."""
    asset = clippable(name)
    positions = (asset.hull["positions"] * np.float32(factor)).astype(np.float32)
    faces = asset.hull["faces"]
    edges = build_edges(faces)
    bound = DistanceTo(asset.positions, asset.faces).of(positions, faces, quiet).bound
    mesh = {"positions": positions, "faces": faces, "edge_vertices": edges.vertices, "edge_faces": edges.faces, "bound": np.array([bound])}
    return replace(asset, levels=(SilhouetteLevel(mesh, grown(positions, faces, edges)),))


def drawn(gpu, asset, max_error_px, camera, antialias="coverage", mode="lambert", **more):
    accuracy = Accuracy(antialias=antialias, max_error_px=max_error_px, **more)
    return render_frame(gpu, asset, RenderRequest(width=128, height=128, camera=camera, accuracy=accuracy, shading=Shading(mode=mode)))


@pytest.mark.parametrize("view", [view for view in VIEWS if view != "close"])  # where nothing can be said of so far a level
@pytest.mark.parametrize("antialias", ["coverage", "line"])
def test_no_pixel_is_without_colour_however_far_the_outline_leaves_the_hull(gpu, view, antialias):
    asset = swollen("bumpy")
    exact = drawn(gpu, asset, None, VIEWS[view], antialias)
    image = drawn(gpu, asset, None, VIEWS[view], antialias, level=0)
    assert image.level is not None and image.level.error_px > 5.0
    beyond = (image.pixels[..., 3] > 0) & (exact.pixels[..., 3] == 0)
    assert beyond.sum() > 150
    # the darkest there can be is a quarter of the surface's light
    assert image.pixels[..., :3][image.pixels[..., 3] > 0].max(axis=1).min() > 90


@pytest.mark.parametrize("view", VIEWS)
@pytest.mark.parametrize("antialias", ["coverage", "none", "line"])
@pytest.mark.parametrize("name", ["bumpy", "knot"])
def test_the_outline_holds_the_exact_one_and_is_off_by_no_more_than_said(gpu, name, view, antialias):
    asset = leveled(name)
    exact = drawn(gpu, asset, None, VIEWS[view], antialias)
    assert exact.level is None
    seen = resolve_camera(RenderRequest(camera=VIEWS[view]).camera, asset.frame, 128, 128, asset.radius)
    for level, its in enumerate(asset.levels):
        if projected_px(seen, asset.corners, its.bound) == np.inf:
            with pytest.raises(CapabilityError, match="too near"):
                drawn(gpu, asset, None, VIEWS[view], antialias, level=level)
            continue
        image = drawn(gpu, asset, None, VIEWS[view], antialias, level=level)
        assert image.level is not None and image.level.level is its
        assert image.level.error_px < image.error_px
        mine, own = image.pixels[..., 3].astype(int), exact.pixels[..., 3].astype(int)
        if antialias == "coverage":
            assert (mine - own >= -1).all()
        rows, columns = np.nonzero(own)
        for y, x in zip(*np.nonzero((mine > 0) & (own == 0)), strict=True):
            assert np.hypot(np.maximum(np.abs(rows - y) - 2, 0), np.maximum(np.abs(columns - x) - 2, 0)).min() <= image.error_px


def test_the_coarser_the_outline_may_be_the_fewer_faces_it_comes_from():
    asset = leveled("bumpy")
    view = resolve_camera(RenderRequest(camera=VIEWS["orbit"]).camera, asset.frame, 128, 128, asset.radius)
    asked = [RenderRequest(accuracy=Accuracy(source="clipped", max_error_px=px)) for px in (2e-3, 3.0, 8.0, 50.0)]
    costs = CostModel("where edges are all that costs", {"edges": {"edges": 1.0}})
    plans = [plan_frame(request, asset, view, costs) for request in asked]
    assert plans[0].level is None
    faces = [len(plan.level.level.faces) for plan in plans if plan.level is not None]
    assert len(set(faces)) >= 2 and faces == sorted(faces, reverse=True)
    assert faces[-1] == len(asset.levels[-1].faces)
    assert all(plan.error_px <= px for plan, px in zip(plans[1:], (3.0, 8.0, 50.0), strict=True))


def test_an_error_that_the_rung_alone_exceeds_leaves_the_exact_outline(gpu):
    image = drawn(gpu, leveled("bumpy"), 0.5, VIEWS["orbit"], "none")
    assert image.level is None
    assert image.error_px > 0.5


def test_the_original_is_drawn_as_it_is(gpu):
    image = drawn(gpu, leveled("bumpy"), 50.0, VIEWS["orbit"], "msaa")
    assert image.level is None and image.rung == "original/msaa"


def test_an_eye_beside_the_mesh_gets_the_exact_outline(gpu):
    beside = {"eye": [0.95, 0.95, 0.1], "target": [0.5, 0.5, 1.0], "fov_y_deg": 150.0}
    assert drawn(gpu, leveled("bumpy"), 500.0, beside).level is None


def test_a_mask_can_be_a_levels(gpu):
    asset = swollen("bumpy")
    image, exact = (drawn(gpu, asset, None, VIEWS["orbit"], mode="mask", level=level) for level in (0, -1))
    assert (image.pixels[..., 3] > 0).sum() > 1.1 * (exact.pixels[..., 3] > 0).sum()


def test_a_smooth_outline_has_no_error_to_keep(gpu):
    with pytest.raises(InvalidRequestError) as refused:
        drawn(gpu, leveled("bumpy"), 1.0, VIEWS["orbit"], smooth=True)
    assert refused.value.where["field"] == "accuracy.max_error_px"
