"""Pictures with strokes against their own outlines, filled by brute force."""

from __future__ import annotations

import math

import numpy as np
import pytest

from schemas.lines import LineKind, Stroke
from schemas.render import ProjectTo, RenderRequest, SilhouetteRequest
from service.camera import resolve_camera
from service.render.frame import render_frame
from service.render.passes.vector_lines import ROUNDED_PX, SIMPLIFIED_PX
from service.silhouette.lines import KINDS
from service.silhouette.strokes import outlines_of, stroked_lines
from tests.service.render.conftest import VIEWS
from tests.service.render.made import bare, unclippable
from tests.service.stroke_oracles import polygons_of, winding

SIDE = 128


@pytest.fixture
def picture(gpu):
    """Draws an asset with strokes, on nothing but lines unless asked otherwise."""

    def drawn(asset, camera=VIEWS["orbit"], size=SIDE, antialias="ssaa", fill="none", background="transparent", **lines):
        request = RenderRequest(
            camera=camera, width=size, height=size, background=background, shading={"fill": fill, "color": "#ffffff", "ambient": 1.0},
            accuracy={"antialias": antialias}, lines={"method": "strokes", **lines},
        )  # fmt: skip
        return render_frame(gpu, asset, request)

    return drawn


def strokes_of(asset, camera, stroke, width, kinds):
    """The same strokes as polylines."""
    view = resolve_camera(RenderRequest(camera=camera).camera, asset.frame, SIDE, SIDE, asset.radius)
    wanted = SilhouetteRequest(
        project=ProjectTo(width=SIDE, height=SIDE), kinds=kinds, visible_only=True, simplify_px=SIMPLIFIED_PX, smooth_px=ROUNDED_PX
    )
    margin = math.ceil(width + stroke.get("wobble_px", 0.0))  # dashes begin where lines do
    return stroked_lines(asset.line_mesh, view, wanted, Stroke(**stroke), dict.fromkeys(KINDS, width), margin)


STROKES = (
    {},
    {"width_by": "depth", "wobble_px": 3.0, "wobble_length_px": 20.0},
    {"width_by": "angle", "least": 0.0, "dash": [9.0, 6.0]},
    {"width_by": "curvature", "wobble_px": 1.0},
)


@pytest.mark.parametrize("stroke", STROKES)
@pytest.mark.parametrize("view", ["orbit", "orthographic", "cropped"])
@pytest.mark.parametrize("name", ["torus", "joined"])
def test_what_is_drawn_is_the_area_of_the_outlines(picture, name, view, stroke):
    asset, width = bare(name), 6.0
    alpha = picture(asset, VIEWS[view], silhouette={"width": width}, stroke=stroke).pixels[:, :, 3] / 255.0
    polygons = polygons_of(*outlines_of(strokes_of(asset, VIEWS[view], stroke, width, [LineKind.SILHOUETTE]), width))
    at = (np.arange(4 * SIDE) + 0.5) / 4.0
    x, y = np.meshgrid(at, at)
    filled = winding(polygons, np.column_stack([x.ravel(), y.ravel()])) != 0
    expected = filled.reshape(SIDE, 4, SIDE, 4).mean(axis=(1, 3))
    assert expected.sum() > 100.0
    off = np.abs(alpha - expected)
    assert off.max() <= 0.26 and (off > 0.07).mean() < 6e-3, "samples on the very border may be on either side"


def test_opacity_that_follows_depth_is_blended_once_however_lines_overlap(picture):
    asset = bare("torus")
    image = picture(asset, silhouette={"width": 10.0, "opacity": 0.5}, stroke={"opacity_by": "depth", "least": 0.5})
    alpha = image.pixels[:, :, 3] / 255.0
    assert np.median(alpha[alpha > 0.01]) > 0.2 and alpha.max() <= 0.5 + 2 / 255
    whole = picture(asset, silhouette={"width": 10.0}).pixels[:, :, 3] == 255
    assert 0.25 - 3 / 255 <= alpha[whole].min() < alpha[whole].max() - 0.1


def test_colours_are_those_of_the_kinds_and_the_first_kind_lies_on_top(picture):
    lines = {"silhouette": {"width": 6.0, "color": "#ff0000"}, "ridge": {"width": 6.0, "color": "#0000ff"}}
    image = picture(bare("cube"), antialias="none", **lines)
    colours = {tuple(color) for color in image.pixels.reshape(-1, 4).tolist()}
    assert colours == {(0, 0, 0, 0), (255, 0, 0, 255), (0, 0, 255, 255)}
    alone = picture(bare("cube"), antialias="none", silhouette=lines["silhouette"])
    assert np.array_equal((image.pixels == (255, 0, 0, 255)).all(axis=2), alone.pixels[:, :, 3] == 255)


def test_strokes_lie_over_a_white_surface_as_they_lie_alone(picture):
    stroke = {"width_by": "depth", "wobble_px": 2.0}
    over = picture(bare("torus"), fill="white", background="#ffffff", stroke=stroke)
    alone = picture(bare("torus"), background="#ffffff", stroke=stroke)
    assert np.abs(over.pixels.astype(int) - alone.pixels).max() <= 2
    assert "surface" in over.plan and "surface" not in alone.plan


def test_a_picture_in_tiles_has_the_lines_of_one_that_is_whole(picture, monkeypatch):
    stroke = {"width_by": "depth", "opacity_by": "curvature", "wobble_px": 2.0}
    whole = picture(bare("torus"), stroke=stroke)
    monkeypatch.setattr("service.render.frame.TILE_SAMPLES", 4 * 48)
    off = np.abs(picture(bare("torus"), stroke=stroke).pixels.astype(int) - whole.pixels)[:, :, 3]
    assert off.max() <= 16 and (off > 1).mean() < 1e-3, "a sample on the very border may be on either side"


def test_boundaries_of_an_open_mesh_are_strokes_too(picture):
    image = picture(unclippable("sphere"), {"eye": [0, 0, 3]}, boundary={"width": 2.0, "color": "#00ff00"}, silhouette=None)
    assert (image.pixels[:, :, 1] == 255).sum() > 100


def test_seeds_tell_pictures_apart_and_a_seed_makes_the_same(picture):
    one, again, other = (picture(bare("torus"), stroke={"wobble_px": 3.0, "seed": seed}).pixels for seed in (1, 1, 2))
    assert np.array_equal(one, again) and not np.array_equal(one, other)


def test_a_mesh_beside_the_picture_and_an_eye_inside_are_drawn(picture):
    beside = {"eye": [0, 0, 4], "target": [-2.9, 0, 0], "fov_y_deg": 40}
    assert not picture(bare("sphere"), beside, silhouette={"width": 1.0}).pixels.any()
    assert picture(bare("sphere"), beside, silhouette={"width": 64.0}).pixels.any()
    inside = {"eye": [0.1, 0.05, 0], "target": [0, 0, 1], "fov_y_deg": 90}
    assert picture(bare("sphere"), inside, fill="shaded", stroke={"width_by": "depth"}).pixels[:, :, 3].any()
