"""Shading that only the mesh has: each by what it must show, and where it is refused."""

import numpy as np
import pytest

from schemas.errors import InvalidRequestError
from schemas.render import RenderRequest
from service.render.frame import render_frame
from service.render.plan import plan_frame
from tests import meshes
from tests.service.render.lined import asset_of
from tests.service.render.made import clippable, seen_from

MODES = ("gooch", "flat", "depth", "matcap")
FRONT = {"eye": [0.0, 0.0, 3.0], "target": [0.0, 0.0, 0.0]}


def drawn(gpu, asset, mode, antialias="none", **shading):
    accuracy = {"source": "original", "antialias": antialias}
    request = RenderRequest(width=96, height=96, camera=FRONT, shading={"mode": mode, **shading}, accuracy=accuracy)
    return render_frame(gpu, asset, request).pixels.astype(int)


@pytest.fixture(scope="module")
def ball():
    return asset_of(meshes.sphere(4), "shaded ball")


def test_gooch_is_warm_where_the_light_is_and_cool_behind(gpu, ball):
    picture = drawn(gpu, ball, "gooch", light=[1.0, 0.0, 0.0])
    lit, dark = picture[48, 80], picture[48, 16]
    assert lit[0] > lit[2] + 40 and dark[2] > dark[0] + 20


def test_flat_faces_have_one_colour_each(gpu):
    picture = drawn(gpu, asset_of(meshes.sphere(1), "faceted ball"), "flat")
    smooth = drawn(gpu, asset_of(meshes.sphere(1), "faceted ball"), "lambert")
    inside = picture[:, :, 3] == 255
    colours, of_smooth = (len(np.unique(one[inside], axis=0)) for one in (picture, smooth))
    assert colours <= 80 < of_smooth


def test_flat_faces_are_lit_by_themselves_whatever_the_normals_at_their_corners(gpu):
    asset = asset_of(meshes.blocks((0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)), "flat blocks")
    request = RenderRequest(width=96, height=96, shading={"mode": "flat"}, accuracy={"source": "original", "antialias": "none"})
    picture = render_frame(gpu, asset, request).pixels
    shown, counts = np.unique(picture[picture[:, :, 3] == 255], axis=0, return_counts=True)
    assert len(shown[counts > 2]) == 3
    assert counts.max() < 0.8 * counts.sum()


def test_depth_is_lighter_the_nearer(gpu, ball):
    picture = drawn(gpu, ball, "depth")
    middle, rim = picture[48, 48, 0], picture[48, [10, 85], 0]
    assert middle > 230 and (rim < middle - 30).all()
    row = picture[48, 48:78, 0]
    assert (np.diff(row) <= 0).all()


def test_matcap_turns_with_the_camera(gpu, ball):
    pictures = []
    for azimuth in (0.0, 137.0):
        camera = {"orbit": {"azimuth_deg": azimuth, "elevation_deg": 25.0}}
        request = RenderRequest(width=96, height=96, camera=camera, shading={"mode": "matcap"})
        pictures.append(render_frame(gpu, ball, request).pixels.astype(int))
    assert np.abs(pictures[0] - pictures[1])[20:76, 20:76].max() <= 8
    assert pictures[0][30, 38].sum() > pictures[0][66, 58].sum() + 60


@pytest.mark.parametrize("mode", MODES)
def test_a_mesh_with_a_hull_is_drawn_itself_with_its_exact_outline(gpu, mode):
    asset = clippable("torus")
    request = RenderRequest(width=96, height=96, shading={"mode": mode})
    image = render_frame(gpu, asset, request)
    assert image.rung == "original/coverage" and "surface" in image.plan
    plain = render_frame(gpu, asset, RenderRequest(width=96, height=96, accuracy={"source": "original"}))
    assert np.array_equal(image.pixels[:, :, 3], plain.pixels[:, :, 3])
    full = image.pixels[:, :, 3] == 255
    assert image.pixels[full][:, :3].max(axis=1).min() > 0


@pytest.mark.parametrize("mode", MODES)
def test_a_clipped_hull_has_none_of_it(mode):
    asset = clippable("torus")
    with pytest.raises(InvalidRequestError) as caught:
        request = RenderRequest(shading={"mode": mode}, accuracy={"source": "clipped"})
        plan_frame(request, asset, seen_from(asset, np.array([3.0, 2.0, 4.0, 1.0])))
    assert caught.value.where["field"] == "accuracy.source"
