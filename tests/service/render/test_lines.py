from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import cKDTree

from benchmarks.line_pixels import compared, inked_pixels, visible_points
from schemas.lines import LineMethod
from schemas.render import RenderRequest
from service.camera import resolve_camera
from service.render import frame as frames
from service.render.frame import render_frame
from service.render.passes import first_layer
from tests import meshes
from tests.service.render.conftest import VIEWS
from tests.service.render.line_oracles import sampled, silhouette_points, within
from tests.service.render.lined import asset_of
from tests.service.render.made import bare, unclippable, without_hull

FILLS = ("shaded", "white", "none")
METHODS = ("wireframe", "translated", "fattened")
BY_SLOPE = {"by": "offset", "amount": 6.0}


@pytest.fixture
def picture(gpu):
    """Draws an asset with lines of a method, on nothing but lines unless asked otherwise."""

    def drawn(asset, method="fattened", camera=VIEWS["orbit"], size=256, antialias="none", fill="none", background="transparent", **lines):
        request = RenderRequest(
            camera=camera, width=size, height=size, background=background, shading={"fill": fill, "color": "#ffffff", "ambient": 1.0},
            accuracy={"antialias": antialias}, lines={"method": method, **lines},
        )  # fmt: skip
        return render_frame(gpu, asset, request)

    return drawn


def view_of(asset, camera, size=256):
    return resolve_camera(RenderRequest(camera=camera).camera, asset.frame, size, size, asset.radius)


def line_pixels(image):
    """(n, 2) centres of pixels that a line covers."""
    rows, columns = np.nonzero(image.pixels[:, :, 3])
    return np.column_stack([columns, rows]) + 0.5


def explained(image, asset, view):
    """(part of the visible silhouette with a line within a pixel, part of the lines within two pixels of visible silhouette)."""
    pixels, _, seen = silhouette_points(asset, view)
    drawn, shown = line_pixels(image), pixels[seen & within(view, pixels)]
    there = cKDTree(drawn).query(shown)[0] <= 1.5
    meant = cKDTree(pixels[seen]).query(drawn)[0] <= 2.0
    return there.mean(), meant.mean()


@pytest.mark.parametrize("view", ["orbit", "above", "close", "orthographic"])
@pytest.mark.parametrize("name", ["sphere", "torus", "joined", "cube"])
@pytest.mark.parametrize(("method", "width"), [("wireframe", 2.0), ("fattened", 1.0)])
def test_lines_are_the_visible_silhouette_and_it_is_lines(picture, method, width, name, view):
    asset = bare(name)
    image = picture(asset, method, VIEWS[view], silhouette={"width": width})
    there, meant = explained(image, asset, view_of(asset, VIEWS[view]))
    assert there >= 0.995
    assert meant >= 0.995


@pytest.mark.parametrize("pull", [BY_SLOPE, {"by": "z", "amount": 0.01}, {"by": "fixed", "amount": 0.02}])
@pytest.mark.parametrize("view", ["orbit", "orthographic"])
def test_pulled_faces_show_along_the_silhouette(picture, view, pull):
    asset = bare("cube")
    image = picture(asset, "translated", VIEWS[view], antialias="ssaa", pull=pull)
    pixels, _, seen = silhouette_points(asset, view_of(asset, VIEWS[view]))
    assert (cKDTree(line_pixels(image)).query(pixels[seen])[0] <= 1.5).mean() >= 0.97
    assert (cKDTree(pixels[seen]).query(line_pixels(image))[0] <= 16.0).mean() >= 0.995


@pytest.mark.parametrize("width", [1.5, 4.0, 8.0, 12.0, 20.0])
@pytest.mark.parametrize("view", ["orbit", "close", "orthographic"])
def test_fattened_lines_are_as_wide_as_was_asked(picture, view, width):
    for name in ("sphere", "torus"):
        asset = bare(name)
        alpha = picture(asset, camera=VIEWS[view], size=512, antialias="ssaa", silhouette={"width": width}).pixels[:, :, 3] / 255.0
        where = view_of(asset, VIEWS[view], 512)
        pixels, normals, seen = silhouette_points(asset, where)
        steps = np.arange(-3.0, width + 4.0, 0.25)
        across = np.array([sampled(alpha, pixels + step * normals) for step in steps])
        alone = seen & within(where, pixels + 30.0 * normals) & (across[0] == 0.0) & (across[-1] == 0.0)
        alone &= cKDTree(pixels).query(pixels + (width + 0.5) * normals)[0] > width + 0.3  # no other part of the silhouette is nearer
        found = 0.25 * across[:, alone].sum(axis=0)
        assert alone.sum() > 200
        assert (np.abs(found - width) <= 0.5).mean() >= 0.95


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("view", ["orbit", "above", "close"])
def test_faces_turned_any_way_give_the_same_lines(picture, method, view):
    for name in ("torus", "knot", "joined"):
        asset = bare(name)
        turned = np.random.default_rng(1).random(len(asset.faces)) < 0.5
        faces = np.where(turned[:, None], asset.faces[:, ::-1], asset.faces)
        shuffled = without_hull(f"shuffled {name}", (asset.frame.to_model(asset.positions), faces), closed=False)
        trusted, any_way = (
            picture(one, method, VIEWS[view], orientation=orientation) for one, orientation in ((asset, "trusted"), (shuffled, "any"))
        )
        assert "first_layer" in any_way.plan and "first_layer" not in trusted.plan
        there, here = trusted.pixels[:, :, 3] > 0, any_way.pixels[:, :, 3] > 0
        assert there.sum() > 100
        assert (there != here).sum() <= 0.03 * there.sum()


def test_what_is_near_and_what_is_far_a_hundred_thousand_times_have_their_lines(picture):
    """Near the eye a sphere of a hundred-thousandth; far away one that hides another by a thousandth of the distance."""
    near = meshes.sphere(2, 2e-5, (1.5e-5, 1e-5, -6e-5))
    far = [meshes.sphere(3, 1.0, (-0.6, -0.4, sign * 5.0)) for sign in (-1, 1)]
    hidden = meshes.sphere(2, 0.1, (-0.6, -0.4, -4.11))
    asset = without_hull("near and far", meshes.joined(near, *far, hidden))
    camera = {"eye": [0.0, 0.0, 0.0], "target": [0.0, 0.0, -1.0], "fov_y_deg": 50.0}
    assert asset.frame.scale > 5.0
    for pull in ({"by": "z", "amount": 1e-5}, {"by": "fixed", "amount": 1e-6}):
        image = picture(asset, "wireframe", camera, silhouette={"width": 2.0}, pull=pull)
        there, meant = explained(image, asset, view_of(asset, camera))
        assert there >= 0.99
        assert meant >= 0.995


@pytest.mark.parametrize("method", METHODS)
def test_tiles_join_without_a_seam(picture, method, monkeypatch):
    more = {"camera": VIEWS["orbit"], "size": 200, "fill": "shaded", "antialias": "msaa", "silhouette": {"width": 9.0}, "ridge": {}}
    for asset in (bare("knot"), unclippable()):
        whole = picture(asset, method, **more)
        with monkeypatch.context() as patched:
            patched.setattr(frames, "TILE_SAMPLES", 128)
            patched.setattr(first_layer, "TILE_PX", 96)
            tiled = picture(asset, method, **more)
        assert (np.abs(whole.pixels.astype(int) - tiled.pixels).max(axis=2) > 2).mean() < 2e-3


def test_pictures_without_lines_stay_what_they_are(gpu, picture):
    rungs = [("original", antialias) for antialias in ("none", "msaa", "ssaa")]
    requests = [RenderRequest(width=100, height=100, accuracy={"source": source, "antialias": how}) for source, how in rungs]
    before = [render_frame(gpu, bare("knot"), request) for request in requests]
    for method in METHODS:
        picture(bare("knot"), method, silhouette={"opacity": 0.5}, pull={"by": "offset"})
        picture(unclippable(), method)
    for earlier, request in zip(before, requests, strict=True):
        later = render_frame(gpu, bare("knot"), request)
        assert np.array_equal(earlier.pixels, later.pixels)
        assert not [name for name in later.plan if "line" in name or name == "charcoal" or name == "first_layer"]


def test_times_are_of_the_passes_that_ran(picture):
    image = picture(unclippable(), "fattened", fill="shaded", antialias="msaa")
    assert [name for name, _ in image.passes] == list(image.plan)
    assert {"first_layer", "line_faces", "line_strokes", "lines_back", "line_edges"} < set(image.plan)


def test_fill_is_the_surface_or_white_or_nothing_and_hides_the_same(picture):
    asset = bare("torus")
    shaded, white, none = (picture(asset, fill=fill, silhouette={"width": 2.0, "color": "#ff0000"}).pixels for fill in FILLS)
    lines = none[:, :, 3] > 0
    assert (none[lines] == (255, 0, 0, 255)).all()
    for filled in (shaded, white):
        assert np.array_equal((filled == (255, 0, 0, 255)).all(axis=2), lines)
    inside = (white[:, :, 3] > 0) & ~lines
    assert inside.sum() > 1000
    assert (white[inside] == 255).all()


def test_translucent_lines_that_overlap_count_once(picture):
    for antialias in ("none", "msaa"):
        for method in ("wireframe", "fattened"):
            image = picture(bare("knot"), method, antialias=antialias, silhouette={"width": 9.0, "opacity": 0.5, "color": "#c02040"})
            alpha = image.pixels[:, :, 3]
            assert alpha.max() in (127, 128)
            assert (alpha[alpha > 0] >= 127).mean() > 0.5
            touched = image.pixels[alpha >= 127][:, :3].astype(int)
            assert np.abs(touched - (0xC0, 0x20, 0x40)).max() <= 2


def test_translucent_lines_are_blended_in_linear_light(picture):
    image = picture(bare("cube"), fill="white", background="#ffffff", silhouette={"width": 8.0, "opacity": 0.5})
    middle = round(255 * (1.055 * 0.5 ** (1 / 2.4) - 0.055))
    assert np.abs(image.pixels[image.pixels[:, :, 0] < 250][:, 0].astype(int) - middle).max() <= 1


def test_edges_of_an_open_mesh_are_lines_and_its_visible_inside_is_none(picture):
    asset = unclippable("sphere")
    image = picture(asset, camera={"eye": [0, 0, 3]}, silhouette={"width": 2.0}, boundary={"width": 2.0, "color": "#00ff00"})
    alpha, green = image.pixels[:, :, 3] > 0, image.pixels[:, :, 1] == 255
    assert green.sum() > 200
    assert not alpha[118:138, 118:138].any()
    without = picture(asset, camera={"eye": [0, 0, 3]}, silhouette=None, boundary=None)
    assert not without.pixels.any()


@pytest.mark.parametrize("method", [LineMethod.WIREFRAME, LineMethod.FATTENED])
def test_folds_of_an_open_mesh_are_lines_where_both_of_their_faces_are_seen(gpu, method):
    """Through its opening a surface shows its inside: there both sides of a fold belong to the nearest layer."""
    vertices, faces = meshes.torus()
    half = faces[vertices[faces][:, :, 2].mean(axis=1) < 0.1 * vertices[:, 2].max()]
    used, numbers = np.unique(half, return_inverse=True)
    asset = asset_of((vertices[used], numbers.reshape(-1, 3)), "half torus")
    for view in range(8):
        inked, points = inked_pixels(gpu, asset, method, view, 8, 384), visible_points(asset, view, 8, 384)
        assert min(compared(inked, points)) > 99.9


def test_ridges_and_valleys_are_told_apart(picture):
    """An L has one valley; a cube has ridges only, three of them inside its outline."""
    profile = np.array([[0, 0], [2, 0], [2, 1], [1, 1], [1, 2], [0, 2]], float)
    vertices = np.concatenate([np.column_stack([profile, np.full(6, z)]) for z in (0.0, 1.0)])
    caps = np.array([[0, 1, 2], [0, 2, 3], [0, 3, 4], [0, 4, 5]])
    sides = [[[i, j, j + 6], [i, j + 6, i + 6]] for i, j in ((k, (k + 1) % 6) for k in range(6))]
    faces = np.concatenate([caps[:, ::-1], caps + 6, np.array(sides).reshape(-1, 3)]).astype(np.int32)
    asset = without_hull("L", (vertices, faces))
    camera = {"eye": [5, 5.5, 6], "target": [0.8, 0.8, 0.5], "fov_y_deg": 35}
    image = picture(asset, camera=camera, silhouette=None, ridge={"width": 2, "color": "#ff0000"}, valley={"width": 2, "color": "#0000ff"})
    view = view_of(asset, camera)
    corner = view.pixels @ np.append(asset.frame.to_normalised([1.0, 1.0, 0.5]), 1.0)
    x, y = (corner[:2] / corner[3]).astype(int)
    assert (image.pixels[y - 1 : y + 2, x - 1 : x + 2] == (0, 0, 255, 255)).all(axis=2).any()
    blue, red = ((image.pixels == color).all(axis=2).sum() for color in ((0, 0, 255, 255), (255, 0, 0, 255)))
    assert red > 3 * blue > 0


def test_charcoal_is_grey_by_facing_and_marks_more_than_the_silhouette(picture):
    asset = bare("sphere")
    front = {"eye": [0, 0, 4], "fov_y_deg": 40}
    image = picture(asset, camera=front, fill="shaded", charcoal=True)
    assert abs(int(image.pixels[128, 128, 0]) - 170) <= 3
    black = [(picture(bare("bumpy"), fill="shaded", charcoal=c).pixels == (0, 0, 0, 255)).all(axis=2).sum() for c in (True, False)]
    assert black[0] > 1.2 * black[1]


def test_lines_of_a_far_mesh_are_thinner_when_clutter_is_to_be_less(picture):
    areas = {}
    for distance in (4.0, 16.0):
        for declutter in (False, True):
            image = picture(
                bare("sphere"), camera={"orbit": {"distance": distance}}, antialias="ssaa", declutter=declutter, silhouette={"width": 8.0}
            )
            areas[distance, declutter] = image.pixels[:, :, 3].sum() / 255.0
    assert areas[16.0, False] / areas[16.0, True] > 3.0
    assert areas[4.0, False] / areas[4.0, True] < 2.0


def test_widths_fall_with_distance_when_they_are_of_the_middle_of_the_mesh(picture):
    asset = without_hull("two", meshes.joined(meshes.sphere(3, 0.5, (-1, 0, 2)), meshes.sphere(3, 0.5, (1.5, 0, -2))))
    camera = {"eye": [0, 0, 6], "fov_y_deg": 50}
    areas = {}
    for scale in ("pixels", "distance"):
        alpha = picture(asset, camera=camera, antialias="ssaa", scale=scale, silhouette={"width": 6.0}).pixels[:, :, 3] / 255.0
        areas[scale] = np.array([alpha[:, :128].sum(), alpha[:, 128:].sum()])
    near, far = areas["distance"] / areas["pixels"]
    assert 1.35 < near < 1.9
    assert 0.6 < far < 0.9


def test_wide_lines_of_a_mesh_beside_the_picture_reach_into_it(picture):
    asset = bare("sphere")
    camera = {"eye": [0, 0, 4], "target": [-2.9, 0, 0], "fov_y_deg": 40}
    assert not picture(asset, camera=camera, silhouette={"width": 1.0}).pixels.any()
    assert picture(asset, camera=camera, silhouette={"width": 64.0}).pixels.any()


@pytest.mark.parametrize("method", METHODS)
def test_an_eye_inside_and_a_surface_through_the_eye_are_drawn(picture, method):
    for name, camera in (("sphere", {"eye": [0.1, 0.05, 0], "target": [0, 0, 1], "fov_y_deg": 90}), ("torus", VIEWS["cropped"])):
        image = picture(bare(name), method, camera, fill="shaded", silhouette={"width": 3.0})
        assert image.pixels[:, :, 3].any()
