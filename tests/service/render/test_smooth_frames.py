from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from scipy.ndimage import distance_transform_edt

from schemas.errors import CapabilityError, InvalidRequestError
from schemas.render import Accuracy, RenderRequest, Shading
from service.render.frame import render_frame
from service.render.plan import plan_frame
from tests import meshes
from tests.service.render.conftest import VIEWS
from tests.service.render.made import clippable, prepared, seen_from, unclippable

COARSE = {
    "sphere": lambda: meshes.sphere(2),
    "torus": lambda: meshes.torus(20, 10),
    "bumpy": lambda: meshes.bumpy_sphere(3, 0.4),
}


@cache
def coarse(name):
    return prepared(f"coarse {name}", COARSE[name](), 300, None)


@pytest.fixture
def shown(gpu):
    def drawn(asset, smooth, source="clipped", camera=VIEWS["orbit"], side=160, **fields):
        request = RenderRequest(camera=camera, width=side, height=side, accuracy=Accuracy(source=source, smooth=smooth), **fields)
        return render_frame(gpu, asset, request)

    return drawn


def test_a_frame_that_does_not_ask_for_it_does_nothing_for_it(shown):
    asset = prepared("untouched", meshes.sphere(2), 300, None)
    image = shown(asset, False)
    assert "smooth" not in image.plan
    assert "smooth_surface" not in asset.__dict__
    assert image.rung == "clipped/coverage"


def test_smooth_frame_says_so_and_claims_no_error_to_the_mesh(shown):
    image = shown(coarse("sphere"), True)
    assert image.plan[:4] == ("background", "edges", "segments", "smooth")
    assert image.rung == "clipped/coverage/smooth"
    assert image.error_px is None


@pytest.mark.parametrize("source", ["clipped", "original"])
def test_smooth_picture_of_a_coarse_sphere_is_a_disc(shown, source):
    side, samples = 160, 8
    view_error = {}
    asset = coarse("sphere")
    for smooth in (False, True):
        image = shown(asset, smooth, source, side=side)
        eye = 1.02 * np.hypot(1.0, 1.0 / np.tan(np.radians(22.5)))
        radius = side / 2.0 / np.tan(np.radians(22.5)) / np.sqrt(eye**2 - 1.0)
        at = (np.arange(side * samples) + 0.5) / samples - side / 2.0
        disc = (at[:, None] ** 2 + at**2 <= radius**2).reshape(side, samples, side, samples).mean(axis=(1, 3))
        view_error[smooth] = np.abs(image.pixels[:, :, 3] / 255.0 - disc).sum()
    assert view_error[False] > 12.0 * view_error[True]


@pytest.mark.parametrize("view", VIEWS)
@pytest.mark.parametrize("source", ["clipped", "original"])
@pytest.mark.parametrize("name", COARSE)
def test_every_pixel_that_a_smooth_outline_touches_is_coloured(shown, name, source, view):
    white = Shading(color="#ffffff", ambient=1.0)
    image = shown(coarse(name), True, source, VIEWS[view], shading=white)
    touched = image.pixels[image.pixels[:, :, 3] > 0]
    assert len(touched)
    assert (touched == 255).all(axis=0)[:3].all()


@pytest.mark.parametrize("view", VIEWS)
@pytest.mark.parametrize("name", COARSE)
def test_smooth_outline_opens_nothing_inside(shown, name, view):
    plain, smooth = (shown(coarse(name), s, camera=VIEWS[view]).pixels[:, :, 3] for s in (False, True))
    gap = (plain == 255) & (smooth < 255)
    reach = coarse(name).smooth_surface.contours(view_of(coarse(name), view)).reach_px
    assert distance_transform_edt(plain == 255)[gap].max(initial=0.0) <= np.sqrt(2.0) * (reach + 4.0)


def view_of(asset, name):
    from service.camera import resolve_camera

    return resolve_camera(RenderRequest(camera=VIEWS[name]).camera, asset.frame, 160, 160, asset.radius)


def test_mask_alone_is_the_alpha_of_the_picture(shown):
    asset = coarse("torus")
    masked = shown(asset, True, shading=Shading(mode="mask"))
    assert "surface" not in masked.plan
    assert np.array_equal(masked.pixels[:, :, 3], shown(asset, True).pixels[:, :, 3])


def test_smooth_is_refused_where_there_is_no_silhouette_or_no_coverage():
    def plan(asset, eye=(3.0, 2.0, 4.0, 1.0), **accuracy):
        return plan_frame(RenderRequest(accuracy=Accuracy(smooth=True, **accuracy)), asset, seen_from(asset, np.array(eye)))

    for asset, eye in ((unclippable(), (3.0, 2.0, 4.0, 1.0)), (clippable("sphere"), (0.1, 0.0, 0.0, 1.0))):
        with pytest.raises(CapabilityError) as caught:
            plan(asset, eye)
        assert caught.value.where["field"] == "accuracy.smooth"
    for antialias in ("none", "line", "msaa", "ssaa"):
        with pytest.raises(InvalidRequestError) as caught:
            plan(clippable("sphere"), antialias=antialias)
        assert caught.value.where["field"] == "accuracy.smooth"
