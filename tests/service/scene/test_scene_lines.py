"""Lines of several objects in one picture: what hides them, whose they are, and what they cost."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import cKDTree

from schemas.errors import InvalidRequestError
from schemas.lines import LineMethod
from schemas.render import Accuracy, RenderRequest
from service.render import frame as frames
from service.render import group
from service.render.frame import render_frame
from service.scene import plan as planning
from tests.service.render.made import unclippable
from tests.service.scene.lined import (
    BEHIND,
    CAMERA,
    CAMERAS,
    FLAT,
    LINKED,
    METHODS,
    MIRRORED,
    differing,
    drawn,
    ink,
    merged,
    planned,
    shape,
    visible_points,
)
from tests.service.scene.made import COLORS, scene, small
from tests.service.scene.test_draw import SCENES, check

HIDING = {
    "one before another": [("ring", {}), ("knot", BEHIND)],
    "linked rings": [("ring", {}), ("ring", LINKED)],
    "mirrored and stretched": [("ring", {}), ("ring", MIRRORED), ("box", {"translate": [-0.4, -1.2, -2.0], "scale": [2.0, 0.3, -0.8]})],
    "small before large": [("ball", {"scale": 1.3}), ("ring", {"translate": [0.5, 0.4, 1.8], "scale": 0.4})],
}
EVERY = {
    "ridges": {"method": "edge_mesh", "ridge": {"color": "#b03020"}},
    "translucent edge mesh": {"method": "edge_mesh", "silhouette": {"width": 7.0, "opacity": 0.4}, "ridge": {}},
    "by distance": {"method": "edge_mesh", "orientation": "any", "scale": "distance", "silhouette": {"width": 4.0}},
    "wireframe": {"method": "wireframe", "silhouette": {"width": 3.0}, "ridge": {}},
    "wireframe, pulled": {"method": "wireframe", "pull": {"by": "fixed", "amount": 0.05}},
    "translated": {"method": "translated"},
    "translated, fixed": {"method": "translated", "pull": {"by": "fixed", "amount": 0.03}},
    "translated, offset": {"method": "translated", "pull": {"by": "offset"}},
    "translucent fattened": {"method": "fattened", "silhouette": {"width": 4.0, "opacity": 0.5}},
    "charcoal": {"method": "fattened", "charcoal": True},
    "any orientation": {"method": "fattened", "orientation": "any", "declutter": True, "silhouette": {"width": 6.0}},
}


@pytest.mark.parametrize("camera", CAMERAS)
@pytest.mark.parametrize("name", HIDING)
@pytest.mark.parametrize("methods", [("edge_mesh",), ("wireframe",), ("fattened",), ("edge_mesh", "fattened", "wireframe")], ids="+".join)
def test_lines_are_those_that_are_visible_of_all_objects_as_one_mesh(gpu, methods, name, camera):
    """Methods take turns from object to object. The exact lines are found in space, with the objects as one mesh."""
    styles = {"edge_mesh": 1.5, "wireframe": 2.0, "fattened": 1.0}
    objects = [
        (mesh, transform, {"lines": {"method": methods[k % len(methods)], "silhouette": {"width": styles[methods[k % len(methods)]]}}})
        for k, (mesh, transform) in enumerate(HIDING[name])
    ]
    lines = ink(drawn(gpu, objects, camera=CAMERAS[camera], accuracy={"antialias": "none"}).pixels)
    exact = visible_points(merged(HIDING[name], name), CAMERAS[camera], ["silhouette"])
    inside = exact[((exact > 2) & (exact < 198)).all(axis=1)]
    assert len(inside) > 500
    assert (cKDTree(lines).query(inside)[0] <= 1.5).mean() >= 0.99
    assert (cKDTree(exact).query(lines)[0] <= 2.0).mean() >= 0.99


def test_ridges_are_hidden_by_other_objects_too(gpu):
    objects = [("corner", {}), ("ball", {"translate": [0.5, 0.5, 1.6], "scale": 0.4})]
    lines = {"silhouette": None, "ridge": {}, "valley": {}}
    exact = visible_points(merged(objects, "corner and ball"), CAMERA, ["ridge", "valley"])
    alone = visible_points(merged(objects[:1], "corner"), CAMERA, ["ridge", "valley"])
    assert len(exact) < 0.9 * len(alone)
    for method in ("edge_mesh", "fattened"):
        found = ink(drawn(gpu, objects, lines={"method": method, **lines}, accuracy={"antialias": "none"}).pixels)
        assert (cKDTree(found).query(exact)[0] <= 1.5).mean() >= 0.98
        assert (cKDTree(exact).query(found)[0] <= 2.0).mean() >= 0.98


@pytest.mark.parametrize("background", ["transparent", "#3060a0"])
@pytest.mark.parametrize("camera", [CAMERA, FLAT, {"orbit": {"azimuth_deg": 40}}], ids=["eye", "orthographic", "orbit"])
@pytest.mark.parametrize(
    ("name", "fill"), [(name, fill) for name in EVERY for fill in ("shaded", "white", "none") if fill == "shaded" or name != "charcoal"]
)
def test_one_object_is_byte_by_byte_the_picture_of_its_mesh(gpu, name, fill, camera, background):
    shared = {"camera": camera, "width": 96, "height": 80, "background": background, "lines": EVERY[name], "shading": {"fill": fill}}
    alone = render_frame(gpu, shape("ring"), RenderRequest.model_validate(shared))
    image = drawn(gpu, [("ring", {})], size=(96, 80), **{key: shared[key] for key in ("camera", "background", "lines", "shading")})
    expected = np.where(alone.pixels[:, :, 3:] == 0, np.uint8(0), alone.pixels)
    assert (expected != expected[0, 0]).any()
    assert np.array_equal(image.pixels, expected)
    assert (image.rung, image.error_px) == (alone.rung, None)


@pytest.mark.parametrize("camera", CAMERAS)
@pytest.mark.parametrize("lines", [EVERY[name] for name in EVERY if name != "by distance"])
def test_objects_that_do_not_meet_look_as_they_do_alone(gpu, lines, camera):
    """Their common range of depths, and its unit, change nothing. One is small, mirrored and turned."""
    left = ("ring", {"translate": [-1.8, 0, 0]})
    right = ("ring", {"translate": [1.4, 0.2, -0.5], "scale": -0.5, "rotate": {"axis": [1, 2, 0], "angle_deg": 50}})
    camera = CAMERAS[camera] | {"eye": [0.0, 1.5, 8.0]}
    more = {"camera": camera, "size": (320, 200), "lines": lines, "shading": {"color": "#d0c0a0"}, "background": "transparent"}
    both, one, other = (drawn(gpu, objects, **more).pixels for objects in ([left, right], [left], [right]))
    assert one[:, 160:].max() == 0 == other[:, :160].max()
    alone = np.concatenate([one[:, :160], other[:, 160:]], axis=1)
    assert (alone[:, :, 3] > 0).mean() > 0.08
    assert differing(both, alone, 8) < 0.01


@pytest.mark.parametrize("lines", EVERY.values(), ids=EVERY)
def test_a_mirrored_scene_is_the_mirrored_picture(gpu, lines):
    objects = [("ring", {"translate": [0.3, 0, 0]}), ("knot", {"translate": [-0.5, 0.4, -2.0]})]
    mirrored = [(mesh, {"translate": [-t["translate"][0], *t["translate"][1:]], "scale": [-1, 1, 1]}) for mesh, t in objects]
    more = {
        "camera": {"eye": [0, 1.0, 6.0], "fov_y_deg": 40},
        "lines": lines,
        "shading": {"ambient": 1.0},
        "accuracy": {"antialias": "ssaa"},
    }
    plain, image = (drawn(gpu, one, **more).pixels for one in (objects, mirrored))
    assert (plain != plain[0, 0]).any(axis=2).mean() > 0.1
    assert differing(plain[:, ::-1], image, 24) < 0.01


@pytest.mark.parametrize("camera", CAMERAS)
@pytest.mark.parametrize("lines", EVERY.values(), ids=EVERY)
def test_a_scene_that_is_larger_as_a_whole_is_the_same_picture(gpu, lines, camera):
    def grown(factor):
        camera_there = CAMERAS[camera] | {"eye": [factor * x for x in CAMERAS[camera]["eye"]]}
        if "height" in camera_there:
            camera_there["height"] *= factor
        behind = BEHIND | {"translate": [factor * x for x in BEHIND["translate"]], "scale": factor * BEHIND["scale"]}
        return drawn(gpu, [("ring", {"scale": factor}), ("knot", behind)], camera=camera_there, lines=lines).pixels

    assert differing(grown(1.0), grown(1e4), 8) < 0.003


@pytest.mark.parametrize("lines", EVERY.values(), ids=EVERY)
def test_tiles_join_without_a_seam(gpu, lines, monkeypatch):
    more = {"lines": lines, "size": (220, 180), "shading": {"color": "#d0c0a0"}}
    whole = drawn(gpu, HIDING["linked rings"], **more).pixels
    monkeypatch.setattr(frames, "TILE_SAMPLES", 128)
    assert differing(whole, drawn(gpu, HIDING["linked rings"], **more).pixels) < 0.005


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("antialias", ["none", "msaa", "ssaa"])
def test_every_method_has_its_passes_with_every_kind_of_samples(gpu, method, antialias):
    image = drawn(gpu, HIDING["linked rings"], lines={"method": method}, accuracy={"antialias": antialias})
    passes = {"edge_mesh": {"edge_mesh"}, "translated": {"line_faces", "lines_back"}}
    assert {name for name, _ in image.passes} >= passes.get(method, {"line_faces", "line_strokes", "lines_back"}) | {"surface", "over"}
    assert image.rung == f"original/{antialias}"
    assert image.error_px is None
    assert len(image.plan) == 1
    assert image.plan[0].startswith(f"layer[0]: objects 0+1 original/{antialias} (")
    assert image.plan[0].endswith("; together: lines need a common depth)")


def test_a_scene_without_lines_has_none_of_their_passes(gpu):
    image = drawn(gpu, HIDING["linked rings"])
    assert not {name for name, _ in image.passes} & set(group.LINE_PASSES)


@pytest.mark.parametrize("deep", [{}, {"method": "wireframe", "ridge": {}, "ridge_deg": 180.0}], ids=["usual depth", "deep"])
@pytest.mark.parametrize("name", [name for name in SCENES if name != "the same twice"])
def test_each_pixel_shows_the_nearest_object_under_lines_that_are_nowhere(gpu, name, deep):
    """The one kind of lines that is asked for is of edges that fold flat."""
    request, assets = scene(SCENES[name], camera={"eye": [2.0, 1.5, 5.0]}, antialias="none", source="original")
    nowhere = {"silhouette": None, "boundary": None, "ridge": {}, "ridge_deg": 180.0}
    check(gpu, request.model_validate(request.model_dump(exclude_unset=True) | {"lines": nowhere | deep}), assets)


@pytest.mark.parametrize("turned", [False, True])
@pytest.mark.parametrize("method", ["edge_mesh", "fattened"])
def test_an_object_without_a_fill_hides_what_is_behind_it_and_shows_the_background(gpu, method, turned):
    near = ("ball", {"translate": [0, 0, 2.0], "scale": 0.5}, {"shading": {"fill": "none"}})
    far = ("box", {"translate": [-1.5, -1.5, -3.0], "scale": 3.0}, {"lines": None, "shading": {"color": "#00ff00"}})
    objects = [far, near] if turned else [near, far]
    image = drawn(gpu, objects, camera={"eye": [0, 0, 8]}, lines={"method": method}, background="transparent")
    assert (image.pixels[100, 100] == 0).all()
    assert (image.pixels[100, 100 + 30] == (0, 255, 0, 255)).all()
    assert (image.pixels[:, :, :3][image.pixels[:, :, 3] == 255] == 0).all(axis=1).sum() > 50


def test_an_object_without_lines_has_none_and_may_be_white(gpu):
    objects = [("ball", {"translate": [-1.2, 0, 0]}, {"lines": None, "shading": {"fill": "white"}}), ("ball", {"translate": [1.2, 0, 0]})]
    image = drawn(
        gpu, objects, camera={"eye": [0, 0, 8]}, lines={"silhouette": {"width": 3}}, shading={"color": "#c00000"}, background="#000080"
    ).pixels
    left = (image[:, :100] == (255, 255, 255, 255)).all(axis=2).sum()
    assert left > 1500
    assert not (image[:, 100:] == 255).all(axis=2).any()
    assert not (image[:, :100, :3] == 0).all(axis=2).any()
    assert (image[:, 100:, :3] == 0).all(axis=2).sum() > 100


def test_lines_of_a_nearer_object_are_over_those_of_a_farther_one(gpu):
    """Where the outlines cross, the nearer object's colour is there, in whichever order the objects are given."""
    near = ("ball", {"translate": [0.5, 0, 2], "scale": 0.7}, {"lines": {"silhouette": {"color": "#ff0000", "width": 8}}})
    far = ("ball", {"translate": [-0.3, 0, -2]}, {"lines": {"silhouette": {"color": "#0000ff", "width": 8}}})
    pictures = [
        drawn(gpu, objects, camera={"eye": [0, 0, 8]}, lines={}, accuracy={"antialias": "none"}).pixels
        for objects in ([near, far], [far, near])
    ]
    alone = drawn(gpu, [near], camera={"eye": [0, 0, 8]}, lines={}, accuracy={"antialias": "none"}).pixels
    red = (alone == (255, 0, 0, 255)).all(axis=2)
    for picture in pictures:
        assert np.array_equal((picture == (255, 0, 0, 255)).all(axis=2), red)
        assert (picture == (0, 0, 255, 255)).all(axis=2).sum() > 300


@pytest.mark.parametrize("antialias", ["none", "msaa"])
@pytest.mark.parametrize("methods", [("edge_mesh", "edge_mesh"), ("fattened", "fattened"), ("fattened", "edge_mesh")])
def test_translucent_lines_count_once_for_each_object(gpu, methods, antialias):
    style = {"width": 9.0, "opacity": 0.5, "color": "#c02040"}
    objects = [
        (mesh, transform, {"lines": {"method": method, "silhouette": style}})
        for (mesh, transform), method in zip(HIDING["one before another"], methods, strict=True)
    ]
    image = drawn(gpu, objects, shading={"fill": "none"}, accuracy={"antialias": antialias}, background="transparent").pixels
    alpha = image[:, :, 3]
    assert alpha.max() in (191, 192)
    assert (np.abs(alpha[alpha > 0].astype(int) - 127.5) <= 0.5).mean() > 0.5
    touched = image[alpha >= 127][:, :3].astype(int)
    assert np.abs(touched - (0xC0, 0x20, 0x40)).max() <= 2


def test_widths_by_distance_are_those_at_the_middle_of_the_scene(gpu):
    objects = [("ball", {"translate": [-1.0, 0, 2], "scale": 0.5}), ("ball", {"translate": [1.5, 0, -2], "scale": 0.5})]
    more = {"camera": {"eye": [0, 0, 6], "fov_y_deg": 50}, "shading": {"fill": "none"}, "background": "transparent"}
    for method in ("edge_mesh", "fattened"):
        sums = []
        for scale in ("pixels", "distance"):
            alpha = drawn(gpu, objects, lines={"method": method, "scale": scale, "silhouette": {"width": 6.0}}, **more).pixels[:, :, 3]
            sums.append([alpha[:, :100].sum() / 255.0, alpha[:, 100:].sum() / 255.0])
        near, far = np.array(sums[1]) / np.array(sums[0])
        assert 1.35 < near < 1.9
        assert 0.6 < far < 0.9


@pytest.mark.parametrize("method", ["edge_mesh", "fattened"])
def test_far_objects_are_told_apart_though_a_near_one_is_in_the_picture(gpu, method):
    """Two that go through each other a thousand units away, and a ball a quarter of a unit away, a thousandth of one across."""
    far = [("ring", {"translate": [0, 0, -1000], "scale": 10})]
    far += [("knot", {"rotate": {"axis": [1, 1, 0], "angle_deg": 70}, "translate": [-6, 2, -1022], "scale": 12})]
    near = ("ball", {"translate": [0.004, 0.003, -0.25], "scale": 0.0005})
    more = {"camera": {"eye": [0, 0, 0], "target": [0, 0, -1], "fov_y_deg": 2.2}, "lines": {"method": method}, "size": (400, 400)}
    with_it, without = (drawn(gpu, objects, **more).pixels[100:] for objects in ([*far, near], far))
    assert differing(with_it, without, 30) < 0.003


def test_wide_lines_of_an_object_beside_the_picture_reach_into_it(gpu):
    objects = [("ball", {}), ("ball", {"translate": [0, 0, 0], "scale": 0.001})]
    camera = {"eye": [0, 0, 4], "target": [-2.9, 0, 0], "fov_y_deg": 40}
    for width, seen in ((1.0, False), (64.0, True)):
        image = drawn(gpu, objects, camera=camera, lines={"silhouette": {"width": width}}).pixels
        assert (ink(image).size > 0) == seen


def test_open_objects_have_their_borders_and_the_nearest_layer_is_their_own(gpu):
    """What is before an open object does not change which of its faces are nearest."""
    opened = unclippable("sphere")
    lines = {"method": "fattened", "silhouette": {"width": 2.0}, "boundary": {"width": 2.0, "color": "#00ff00"}}
    more = {"camera": {"eye": [0, 0, 5]}, "lines": lines}
    ball = ("ball", {"translate": [0.9, 0, 2.0], "scale": 0.5}, {"lines": None})
    both = drawn(gpu, [("open", {}), ball], [opened, shape("ball")], **more)
    alone = drawn(gpu, [("open", {})], [opened], **more)
    assert "first_layer" in dict(both.passes)
    half = np.s_[:, :95]
    assert (alone.pixels[half] == (0, 255, 0, 255)).all(axis=2).sum() > 50
    assert differing(both.pixels[half], alone.pixels[half]) < 0.01


def test_clippable_objects_are_drawn_with_lines_from_their_originals():
    assets = [small("ring"), small("ball"), small("box")]
    objects = [("ring", {}), ("ball", {"translate": [0, 0, -3]}), ("box", {"translate": [90, 0, 0]})]
    plan = planned(objects, assets, lines={"silhouette": {"opacity": 0.5}})
    assert all(asset.hull is not None for asset in assets)
    assert plan.outside == (2,)
    assert [part.index for part in plan.layers[0].parts] == [1, 0], "the farther one first"
    assert all(part.request.accuracy == Accuracy(source="original", antialias="msaa") for part in plan.layers[0].parts)


REFUSED = [
    ({"lines": {}, "accuracy": {"source": "clipped"}}, "accuracy.source", "original mesh"),
    ({"lines": {}, "accuracy": {"antialias": "coverage"}}, "accuracy.antialias", "none, msaa or ssaa"),
    ({"lines": {}, "accuracy": {"max_error_px": 1.0}}, "accuracy.max_error_px", "max_error_px"),
    ({"lines": {}, "accuracy": {"budget_ms": 1.0}}, "accuracy.budget_ms", "budget_ms"),
    ({"lines": {}, "accuracy": {"smooth": True}}, "accuracy.smooth", "smooth"),
    ({"lines": {"charcoal": True}}, "lines.charcoal", r"objects\[0\]"),
    ({"lines": {}, "shading": {"mode": "mask"}}, "shading.mode", r"objects\[0\]"),
    ({"shading": {"fill": "white"}}, "shading.fill", "needs lines"),
    ({"own": {"lines": {"declutter": True}}}, "objects[1].lines.declutter", r"objects\[1\]"),
    ({"own": {"lines": {}, "shading": {"mode": "mask"}}}, "objects[1].shading.mode", r"objects\[1\]"),
    ({"own": {"lines": {"pull": {"amount": 2.0}}}}, "objects[1].lines.pull.amount", "below 1"),
    ({"own": {"shading": {"fill": "none"}}}, "objects[1].shading.fill", "needs lines"),
    ({"own": {"lines": {}}, "accuracy": {"source": "clipped"}}, "accuracy.source", "original mesh"),
]


@pytest.mark.parametrize(("fields", "field", "word"), REFUSED)
def test_what_makes_no_sense_is_refused_by_its_field_and_object(fields, field, word):
    fields = dict(fields)
    with pytest.raises(InvalidRequestError, match=word) as caught:
        planned([("ring", {}), ("ball", BEHIND, fields.pop("own", {}))], **fields)
    assert caught.value.where["field"] == field


def test_lines_that_only_single_meshes_have_are_refused(monkeypatch):
    monkeypatch.setattr(planning, "METHODS", planning.METHODS - {LineMethod.FATTENED})
    planned([("ring", {}), ("ball", BEHIND)], lines={})
    with pytest.raises(InvalidRequestError, match="of single meshes, not scenes") as caught:
        planned([("ring", {}), ("ball", BEHIND, {"lines": {"method": "fattened"}})])
    assert caught.value.where["field"] == "objects[1].lines.method"


def test_colours_of_a_crowd_are_told_apart_under_lines(gpu):
    """Sixty-four objects, each with translucent lines of three kinds: more marks than a byte has."""
    rng = np.random.default_rng(3)
    style = {"width": 2.0, "opacity": 0.5}
    objects = [
        (
            "box",
            {"translate": rng.uniform(-3, 3, 3).tolist(), "scale": 0.6},
            {"shading": {"color": COLORS[k % len(COLORS)], "ambient": 1.0}},
        )
        for k in range(64)
    ]
    lines = {"method": "fattened", "silhouette": style, "ridge": style, "valley": style, "boundary": style}
    image = drawn(
        gpu, objects, camera={"orbit": {"azimuth_deg": 30}}, lines=lines, accuracy={"antialias": "none"}, background="transparent"
    )
    plain = drawn(gpu, objects, camera={"orbit": {"azimuth_deg": 30}}, accuracy={"antialias": "none"}, background="transparent")
    for color in ("#ff0000", "#00ff00", "#0000ff"):
        word = [int(color[i : i + 2], 16) for i in (1, 3, 5)] + [255]
        before, after = ((one.pixels == word).all(axis=2).sum() for one in (plain, image))
        assert 0.3 * before < after < before
