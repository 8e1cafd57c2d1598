"""Pictures of scenes, against rays cast at the originals."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from schemas.errors import CapabilityError, InvalidRequestError
from schemas.render import Accuracy, RenderRequest, Shading
from schemas.scene import SceneRequest
from service.render.frame import render_frame
from service.render.group import Member, render_group
from service.render.state import LINEAR_TABLE, parse_color
from service.scene.draw import draw_scene
from service.scene.plan import plan_scene
from tests.service.scene.made import COLORS, rotation, scene, small, turned
from tests.service.scene.oracles import nearest_objects
from tests.service.scene.test_order import FLAT, FRONT, bars

NEAR = {"eye": [2.0, 1.5, 5.0]}
RINGS = [("ring", {}), ("ring", {"translate": [1, 0, 0], "rotate": turned(90, (1, 0, 0))})]
MIRRORED = [[-1.0, 0.3, 0.0, 0.5], [0.0, 1.5, 0.2, -0.3], [0.4, 0.0, 0.7, -2.0], [0.0, 0.0, 0.0, 1.0]]
SCENES = {
    "one": [("ring", {})],
    "row": [("ball", {"translate": [0.7 * z, 0.2 * z, 2.2 * z], "scale": 0.8}) for z in (0, -2, 1, -1)],
    "interlocked": RINGS,
    "interlocked between others": [
        *RINGS,
        ("ball", {"translate": [0.4, 0.0, -4.0]}),
        ("box", {"translate": [-0.5, -0.9, 1.6], "scale": 0.7}),
    ],
    "circle": [*bars(), ("ball", {"translate": [0, 0, -3]})],
    "mirrored": [("ring", MIRRORED), ("box", {"scale": [-1, 1, 1]}), ("ball", {"translate": [0, 1, 2], "scale": [-0.4, -0.5, -0.3]})],
    "stretched": [
        ("ball", {"scale": [0.3, 1.4, 0.8]}),
        ("ring", {"translate": [0.5, 0, -2], "scale": [1, 2, 0.5], "rotate": turned(40, (1, 1, 0))}),
    ],
    "touching": [("box", {}), ("box", {"translate": [1, 0, 0]}), ("box", {"translate": [0.3, 1, 0.1]})],
    "the same twice": [("box", {}), ("box", {}), ("ball", {"translate": [0, 0, -3]})],
    "open": [("open", {"rotate": turned(200)}), ("ball", {"scale": 0.4}), ("box", {"translate": [0.5, 0.4, -4]})],
    "behind the eye": [("ball", {}), ("ball", {"translate": [4, 3, 12]}), ("box", {"translate": [40, 0, 0]})],
}


def drawn(gpu, request, assets):
    return draw_scene(gpu, plan_scene(request, assets))


def identified(pixels):
    """(h, w) int: the object whose colour each pixel is nearest to in linear light; -1 where it is nearer to empty."""
    palette = np.array([parse_color(color) for color in COLORS]) // 255
    nearest = np.linalg.norm(LINEAR_TABLE[pixels[:, :, None, :3]] - palette, axis=3).argmin(axis=2)
    return np.where(pixels[:, :, 3] > 127, nearest, -1)


def check(gpu, request, assets, least=0.02, finer=2):
    """Every pixel that rays all over it agree about shows what they met."""
    picture = drawn(gpu, request, assets)
    true, seen = nearest_objects(request, assets, finer), identified(picture.pixels)
    sure = true != -2
    assert (true[sure] >= 0).mean() >= least
    wrong = np.argwhere(sure & (seen != true))
    assert not len(wrong), (wrong[:5], picture.plan)
    return picture


@pytest.mark.parametrize("camera", [FRONT, FLAT, NEAR], ids=["front", "orthographic", "near"])
@pytest.mark.parametrize("name", SCENES)
@pytest.mark.parametrize("antialias", ["coverage", "none"])
def test_each_pixel_shows_the_nearest_object(gpu, name, camera, antialias):
    check(gpu, *scene(SCENES[name], camera=camera, antialias=antialias))


@pytest.mark.parametrize("antialias", ["line", "msaa", "ssaa"])
@pytest.mark.parametrize("name", ["row", "interlocked", "mirrored"])
def test_each_pixel_shows_the_nearest_object_on_other_rungs(gpu, name, antialias):
    check(gpu, *scene(SCENES[name], camera=NEAR, antialias=antialias))


@pytest.mark.parametrize("antialias", ["none", "coverage", "msaa", "ssaa"])
def test_originals_show_the_nearest_object(gpu, antialias):
    check(gpu, *scene(SCENES["mirrored"], camera=NEAR, antialias=antialias, source="original"))


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_each_pixel_of_random_scenes_shows_the_nearest_object(gpu, seed):
    rng = np.random.default_rng(seed)
    objects = []
    for _ in range(rng.integers(1, 7)):
        scale = (rng.uniform(0.3, 1.2, 3) * rng.choice([-1, 1], 3)).tolist()
        place = rng.uniform(-2.0, 2.0, 3).tolist()
        objects.append((str(rng.choice(["ball", "box", "ring"])), {"translate": place, "rotate": rotation(rng), "scale": scale}))
    camera = [FRONT, FLAT, {"eye": rng.uniform(3, 4, 3).tolist(), "fov_y_deg": 70}, {"orbit": {"azimuth_deg": rng.uniform(0, 360)}}][
        seed % 4
    ]
    check(gpu, *scene(objects, camera=camera, size=(20, 16)), least=0.0, finer=4)


@pytest.mark.parametrize("background", ["transparent", "#3060a0"])
@pytest.mark.parametrize(
    "accuracy", [("auto", "coverage"), ("clipped", "line"), ("clipped", "none"), ("original", "msaa"), ("original", "coverage")]
)
@pytest.mark.parametrize("camera", [NEAR, FLAT, {"orbit": {"azimuth_deg": 40, "elevation_deg": 25}}])
def test_one_object_is_pixel_by_pixel_the_picture_of_its_mesh(gpu, camera, accuracy, background):
    shared = {
        "camera": camera,
        "width": 120,
        "height": 100,
        "background": background,
        "accuracy": Accuracy(source=accuracy[0], antialias=accuracy[1]),
        "shading": Shading(color="#d09040"),
    }
    alone = render_frame(gpu, small("knot"), RenderRequest(**shared))
    image = drawn(gpu, SceneRequest(objects=[{"mesh": "knot"}], **shared), [small("knot")])
    expected = np.where(alone.pixels[:, :, 3:] == 0, np.uint8(0), alone.pixels)  # what is not there may have a colour in one of them
    assert (expected[:, :, 3] > 0).mean() > 0.1
    assert np.array_equal(image.pixels, expected)
    assert (image.rung, image.error_px) == (alone.rung, alone.error_px)


def test_layers_are_antialiased_as_exactly_as_single_pictures(gpu):
    """Alpha of layers that overlap is that of OVER of their exact areas."""
    request, assets = scene(SCENES["row"], camera=NEAR, size=(96, 96))
    whole = drawn(gpu, request, assets).pixels[:, :, 3] / 255.0
    clear = np.ones_like(whole)
    for k, (asset, item) in enumerate(zip(assets, request.objects, strict=True)):
        alone = drawn(gpu, request.model_copy(update={"objects": [item]}), [asset]).pixels[:, :, 3] / 255.0
        assert alone.any(), k
        clear *= 1.0 - alone
    assert np.abs(whole - (1.0 - clear)).max() <= 0.51 / 255.0


def test_an_object_outside_the_picture_costs_nothing(gpu):
    request, assets = scene(SCENES["behind the eye"], camera=FRONT)
    plan = plan_scene(request, assets)
    assert plan.outside == (1, 2)
    assert [[part.index for part in layer.parts] for layer in plan.layers] == [[0]]
    alone = drawn(gpu, *scene(SCENES["behind the eye"][:1], camera=FRONT))
    picture = draw_scene(gpu, plan)
    assert np.array_equal(picture.pixels, alone.pixels)
    assert picture.plan[-2:] == ("outside: object 1", "outside: object 2")


def test_an_empty_picture_is_background(gpu):
    picture = drawn(gpu, *scene(SCENES["row"], camera={"eye": [0, 0, 90], "target": [0, 0, 99]}, background="#102030"))
    assert (picture.pixels == (0x10, 0x20, 0x30, 0xFF)).all()
    assert picture.rung == "empty"


def test_the_plan_says_what_is_drawn_together_and_why(gpu):
    picture = drawn(gpu, *scene(SCENES["interlocked between others"], camera=FRONT))
    heads = [step.split(" (")[0] for step in picture.plan]
    assert heads == ["layer[0]: object 2 clipped/coverage", "layer[1]: objects 0+1 original/msaa", "layer[2]: object 3 clipped/coverage"]
    assert "together: their convex hulls meet" in picture.plan[1]
    assert picture.rung == "clipped/coverage+original/msaa"
    assert "hide each other in a circle" in drawn(gpu, *scene(SCENES["circle"], camera=FRONT)).plan[1]
    assert not any("," in step for step in picture.plan), "the header's list is divided by commas"


def test_originals_without_outlines_are_one_group(gpu):
    plan = plan_scene(*scene(SCENES["row"], camera=NEAR, antialias="ssaa", source="original"))
    assert [len(layer.parts) for layer in plan.layers] == [4]


def test_an_open_mesh_and_an_eye_inside_a_hull_are_drawn_from_the_original(gpu):
    plan = plan_scene(*scene([("open", {}), ("ball", {"translate": [0, 0, -5]})], camera=FRONT))
    picture = draw_scene(gpu, plan)
    assert "object 0 original/msaa" in picture.plan[1]
    inside = drawn(
        gpu, *scene([("ring", {"scale": 2.0}), ("ball", {"translate": [0, 0, -5]})], camera={"eye": [0, 0, 0.1], "target": [0, 0, -1]})
    )
    assert "object 1 clipped/coverage" in inside.plan[0]
    assert "object 0 original/msaa" in inside.plan[1] or "outside: object 0" in inside.plan


@pytest.mark.parametrize(
    ("objects", "word"),
    [
        ([("ball", {}), ("open", {"translate": [0, 0, -4]})], r"objects\[1\]: the mesh has boundary"),
        (RINGS, "objects 0, 1 can only be drawn together"),
    ],
)
def test_clipping_that_is_insisted_on_is_refused_with_the_objects(objects, word):
    with pytest.raises(CapabilityError, match=word) as caught:
        plan_scene(*scene(objects, camera=FRONT, source="clipped"))
    assert caught.value.where["field"] == "accuracy.source"


def test_a_rung_that_does_not_exist_is_refused_before_drawing():
    with pytest.raises(InvalidRequestError, match="of the original only"):
        plan_scene(*scene(SCENES["row"], camera=FRONT, source="clipped", antialias="msaa"))


def test_a_group_with_outlines_is_refused(gpu):
    plan = plan_scene(*scene(SCENES["row"], camera=NEAR))
    members = [Member(part.asset, part.request, part.view) for layer in plan.layers for part in layer.parts]
    with pytest.raises(ValueError, match="without outlines"):
        render_group(gpu, members)


@pytest.mark.parametrize("size", [(1, 1), (700, 2), (2, 700), (2300, 2200)])
def test_pictures_of_any_size_have_the_objects_in_them(gpu, size):
    """The largest is drawn in several tiles."""
    request, assets = scene(SCENES["interlocked between others"], camera=FRONT, size=size)
    picture = drawn(gpu, request, assets).pixels
    assert picture.shape == (size[1], size[0], 4)
    small_one = drawn(gpu, request.model_copy(update={"width": 230, "height": 220}), assets).pixels
    if min(size) > 2000:
        shrunk = picture[:2200, :2300, 3].reshape(220, 10, 230, 10).mean(axis=(1, 3))
        assert np.abs(shrunk - small_one[:, :, 3]).mean() < 1.0
    assert picture[:, :, 3].any()
