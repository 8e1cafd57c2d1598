from __future__ import annotations

import ctypes
import threading
import time

import numpy as np
import pytest
from scipy.ndimage import binary_erosion

from schemas.errors import CapabilityError, InvalidRequestError
from service.render import frame as frames
from service.render.targets import LEAST_TARGETS, MOST_BYTES, Targets
from tests.service.render.conftest import VIEWS
from tests.service.render.made import SHAPES, clippable, prepared, unclippable

TRUE = 16
"""Samples along a side of a pixel of the reference."""
ALL_RUNGS = [("clipped", "none"), ("clipped", "line"), ("clipped", "coverage")] + [
    ("original", antialias) for antialias in ("none", "coverage", "msaa", "ssaa")
]


def alpha(image):
    return image.pixels[:, :, 3] / 255.0


def supersampled_alpha(draw, name, camera, side):
    """Part of each pixel that the original covers, by drawing it TRUE times as large."""
    large = alpha(draw(name, "original", "none", (side * TRUE, side * TRUE), {"mode": "mask"}, camera=camera))
    return large.reshape(side, TRUE, side, TRUE).mean(axis=(1, 3))


def edge_error(made, true):
    """(mean absolute error where the truth is neither nothing nor all, part of the other pixels that are wrong).

    A sliver along a pixel's border can pass between the reference's samples, so that only more than 1/50 is wrong.
    """
    edge = (true > 0.0) & (true < 1.0)
    return float(np.abs(made - true)[edge].mean()), float((np.abs(made - true)[~edge] > 0.02).mean())


@pytest.mark.parametrize("view", VIEWS)
@pytest.mark.parametrize("name", ["sphere", "torus", "knot", "joined"])
def test_clipped_hull_covers_the_pixels_that_the_original_covers(draw, name, view):
    clipped = alpha(draw(name, "clipped", "none", camera=VIEWS[view]))
    original = alpha(draw(name, "original", "none", camera=VIEWS[view]))
    assert original.any()
    assert (clipped != original).sum() <= 2


@pytest.mark.parametrize("view", VIEWS)
@pytest.mark.parametrize("name", ["torus", "knot", "joined"])
def test_coverage_is_the_area_that_the_original_covers(draw, name, view):
    true = supersampled_alpha(draw, name, VIEWS[view], 64)
    error, wrong = edge_error(alpha(draw(name, "clipped", "coverage", (64, 64), camera=VIEWS[view])), true)
    assert error <= 0.02
    assert wrong == 0.0


@pytest.mark.parametrize("view", ["orbit", "orthographic"])
def test_each_rung_of_antialiasing_is_more_exact_than_the_one_before(draw, view):
    true = supersampled_alpha(draw, "knot", VIEWS[view], 96)
    errors = [
        edge_error(alpha(draw("knot", "clipped", antialias, (96, 96), camera=VIEWS[view])), true)[0]
        for antialias in ("none", "line", "coverage")
    ]
    assert errors[0] > 4.0 * errors[1]
    assert errors[1] > 1.5 * errors[2]
    assert errors[1] < 0.06
    assert errors[2] < 0.008


@pytest.mark.parametrize("view", VIEWS)
@pytest.mark.parametrize("rung", ALL_RUNGS)
def test_every_pixel_of_a_white_surface_without_shading_is_white(draw, rung, view):
    for name in ("knot", "joined"):
        image = draw(name, *rung, shading={"color": "#ffffff", "ambient": 1.0}, camera=VIEWS[view])
        touched = image.pixels[image.pixels[:, :, 3] > 0]
        assert len(touched)
        assert (touched == 255).all(axis=0)[:3].all()


@pytest.mark.parametrize("rung", [("clipped", "line"), ("clipped", "coverage"), ("original", "coverage")])
@pytest.mark.parametrize("distance", [30.0, 200.0, 3000.0])
def test_object_smaller_than_a_pixel_has_its_colour(draw, rung, distance):
    camera = {"orbit": {"azimuth_deg": 20, "distance": distance}}
    image = draw("sphere", *rung, (65, 65), shading={"color": "#ffffff", "ambient": 1.0}, camera=camera)
    touched = image.pixels[image.pixels[:, :, 3] > 0]
    assert (touched[:, :3] == 255).all()
    if distance < 1000.0:
        assert len(touched)


@pytest.mark.parametrize("rung", ALL_RUNGS)
def test_one_pixel_holds_the_mean_of_the_picture(draw, rung):
    image = draw("torus", *rung, (1, 1), camera=VIEWS["orbit"])
    assert image.pixels.shape == (1, 1, 4)
    if rung[1] == "coverage":
        true = supersampled_alpha(draw, "torus", VIEWS["orbit"], 16).mean()
        assert abs(alpha(image)[0, 0] - true) < 0.01


@pytest.mark.parametrize("rung", ALL_RUNGS)
def test_object_outside_the_picture_draws_nothing(draw, rung):
    image = draw("torus", *rung, camera={"eye": [0, 0, 5], "target": [20, 0, 5.5]}, background="#102030")
    assert image.plan == ("background",)
    assert (image.pixels == (0x10, 0x20, 0x30, 0xFF)).all()


def test_object_behind_the_eye_draws_nothing(draw):
    image = draw("torus", camera={"eye": [0, 0, 5], "target": [0, 0, 9]})
    assert image.plan == ("background",)
    assert not image.pixels.any()


def test_eye_inside_draws_the_original(draw):
    camera = {"eye": [0.1, 0.05, 0], "target": [0, 0, 1], "fov_y_deg": 90}
    image = draw("sphere", camera=camera)
    assert image.rung == "original/msaa"
    assert (image.pixels[:, :, 3] == 255).all()
    with pytest.raises(CapabilityError, match="inside") as caught:
        draw("sphere", "clipped", camera=camera)
    assert caught.value.where["field"] == "accuracy.source"


def test_eye_in_the_hole_of_a_torus_draws_the_original(draw):
    camera = {"eye": [0, 0, 0.05], "target": [1, 0, 0], "fov_y_deg": 70}
    image = draw("torus", antialias="none", camera=camera)
    assert image.rung == "original/none"
    assert (alpha(image)[:, 64] == 1.0).all()


def test_eye_close_to_the_surface_clips_like_the_original(draw):
    camera = {"eye": [1.42, 0.0, 0.1], "target": [1.2, 1.0, 0.0], "fov_y_deg": 100}
    clipped = draw("torus", "clipped", "none", camera=camera)
    original = draw("torus", "original", "none", camera=camera)
    assert 0.1 < alpha(original).mean() < 0.95
    assert (alpha(clipped) != alpha(original)).sum() <= 4


def test_mesh_that_cannot_be_clipped_is_drawn_from_the_original(draw):
    image = draw(unclippable())
    assert image.rung == "original/msaa"
    assert 0.05 < alpha(image).mean() < 0.95
    with pytest.raises(CapabilityError, match="boundary"):
        draw(unclippable(), "clipped")


def test_inner_sides_of_an_open_mesh_are_lit(draw):
    behind = draw(unclippable("sphere"), antialias="none", camera={"eye": [0, 0, 3]})
    assert behind.pixels[64, 64, 3] == 255
    assert behind.pixels[64, 64, 0] > 150


def test_rungs_of_the_original_cannot_be_clipped(draw):
    with pytest.raises(InvalidRequestError) as caught:
        draw("torus", "clipped", "msaa")
    assert caught.value.where["field"] == "accuracy.antialias"


@pytest.mark.parametrize("rung", ALL_RUNGS)
def test_background_is_blended_in_linear_light(draw, rung):
    shading = {"color": "#ffffff", "ambient": 1.0}
    over = draw("knot", *rung, shading=shading, background="#000000", camera=VIEWS["orbit"])
    part = alpha(draw("knot", *rung, shading=shading, camera=VIEWS["orbit"]))
    expected = np.where(part <= 0.0031308, 12.92 * part, 1.055 * part ** (1 / 2.4) - 0.055)
    assert (over.pixels[:, :, 3] == 255).all()
    assert np.abs(over.pixels[:, :, 0] / 255.0 - expected).max() < 1.5 / 255


@pytest.mark.parametrize("antialias", ["none", "line", "coverage"])
def test_mask_has_the_same_alpha_and_no_shading_passes(draw, antialias):
    mask = draw("joined", "clipped", antialias, shading={"mode": "mask", "color": "#ff8000"})
    shaded = draw("joined", "clipped", antialias)
    assert not {"surface", "rim"} & set(mask.plan)
    assert np.array_equal(mask.pixels[:, :, 3], shaded.pixels[:, :, 3])
    assert (mask.pixels[mask.pixels[:, :, 3] > 0][:, :3] == (0xFF, 0x80, 0x00)).all()


def test_exact_mask_needs_no_gl(draw):
    assert draw("joined", "clipped", "coverage", shading={"mode": "mask"}).plan == (
        "background", "edges", "segments", "coverage", "composite",
    )  # fmt: skip


@pytest.mark.parametrize("length", [1e-300, 1e300])
def test_only_the_direction_of_the_light_counts(draw, length):
    front = {"eye": [0, 0, 4]}
    one = draw("sphere", camera=front, shading={"light": [1.0, 2.0, 0.0]}).pixels
    other = draw("sphere", camera=front, shading={"light": [length, 2.0 * length, 0.0]}).pixels
    assert np.array_equal(one, other)


@pytest.mark.parametrize("rung", ALL_RUNGS)
def test_picture_is_upright_and_lit_from_where_the_light_is(draw, rung):
    front = {"eye": [0, 0, 4], "fov_y_deg": 40}
    right = draw("sphere", *rung, camera=front, shading={"light": [1, 0, 0], "ambient": 0.0}).pixels[:, :, 0].astype(int)
    above = draw("sphere", *rung, camera=front, shading={"light": [0, 1, 0], "ambient": 0.0}).pixels[:, :, 0].astype(int)
    assert right[64, 90] > 120 > 20 > right[64, 38]
    assert above[38, 64] > 120 > 20 > above[90, 64]
    ball = draw("sphere", *rung, camera={"eye": [0, 0, 9], "target": [-2.5, -2.5, 0], "fov_y_deg": 60})
    rows, columns = np.nonzero(ball.pixels[:, :, 3])
    assert rows.max() < 64 < columns.min()


@pytest.mark.parametrize("rung", ALL_RUNGS)
def test_normals_are_shown_in_the_frame_of_the_object(draw, rung):
    image = draw("sphere", *rung, camera={"eye": [4, 0, 0], "fov_y_deg": 40}, shading={"mode": "normal"})
    assert np.abs(image.pixels[64, 64, :3].astype(int) - (255, 128, 128)).max() <= 4


@pytest.mark.parametrize("name", ["sphere", "torus", "bumpy"])
def test_clipped_shading_looks_like_the_original(draw, name):
    clipped = draw(name, "clipped", "none", camera=VIEWS["orbit"]).pixels.astype(int)
    original = draw(name, "original", "none", camera=VIEWS["orbit"]).pixels.astype(int)
    both = (clipped[:, :, 3] == 255) & (original[:, :, 3] == 255)
    difference = np.abs(clipped - original)[both][:, :3].max(axis=1)
    assert np.median(difference) <= 3
    assert difference.mean() <= 6


def test_corner_colours_of_the_original_lie_where_they_belong(draw):
    asset = _colored_sphere()
    for rung in ALL_RUNGS:
        image = draw(asset, *rung, camera={"eye": [0, 0, 4], "fov_y_deg": 40}, shading={"ambient": 1.0})
        assert np.abs(image.pixels[64, 90, :3].astype(int) - (255, 0, 0)).max() <= 12, rung
        assert np.abs(image.pixels[64, 38, :3].astype(int) - (0, 0, 255)).max() <= 12, rung
    plain = draw(asset, camera={"eye": [0, 0, 4]}, shading={"ambient": 1.0, "use_mesh_color": False, "color": "#40ff40"})
    assert (plain.pixels[64, 64, :3] == (0x40, 0xFF, 0x40)).all()


def _colored_sphere():
    mesh = SHAPES["sphere"]()
    right = mesh[0][mesh[1]][:, :, 0] > 0
    color = np.where(right[:, :, None], (255, 0, 0, 255), (0, 0, 255, 255)).astype(np.uint8)
    return prepared("colored", mesh, 200, {"corner_color": color})


def test_texture_of_the_original_is_upright(draw):
    corners = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], float)
    faces = np.array([[0, 1, 2], [0, 2, 3]], np.int32)
    quarters = np.array([[(255, 0, 0, 255), (0, 255, 0, 255)], [(0, 0, 255, 255), (255, 255, 255, 255)]], np.uint8)
    texture = quarters.repeat(8, axis=0).repeat(8, axis=1)
    uv = ((corners[faces][:, :, :2] + 1.0) / 2.0).astype(np.float32)
    asset = unclippable()
    quad = type(asset)(
        "quad", asset.frame, corners.astype(np.float32) * 0.5, faces, np.tile(np.float32([0, 0, 1]), (4, 1)),
        {"corner_uv": uv, "texture": texture}, None, None, None, None, asset.clip,
    )  # fmt: skip
    image = draw(quad, antialias="none", shading={"ambient": 1.0}, camera={"eye": [0, 0, 3], "fov_y_deg": 40})
    rows, columns = np.nonzero(image.pixels[:, :, 3])
    top, bottom = np.percentile(rows, [25, 75]).astype(int)
    left, right = np.percentile(columns, [25, 75]).astype(int)
    assert np.abs(image.pixels[top, left].astype(int) - (255, 0, 0, 255)).max() <= 2
    assert np.abs(image.pixels[top, right].astype(int) - (0, 255, 0, 255)).max() <= 2
    assert np.abs(image.pixels[bottom, left].astype(int) - (0, 0, 255, 255)).max() <= 2


@pytest.mark.parametrize("rung", ALL_RUNGS)
def test_tiles_join_without_a_seam(draw, rung, monkeypatch):
    whole = draw("knot", *rung, (150, 130), camera=VIEWS["orbit"])
    monkeypatch.setattr(frames, "TILE_SAMPLES", 128)
    tiled = draw("knot", *rung, (150, 130), camera=VIEWS["orbit"])
    differing = np.abs(whole.pixels.astype(int) - tiled.pixels).max(axis=2) > 2
    assert differing.mean() < 2e-3


@pytest.mark.parametrize("size", [(300, 40), (33, 257)])
def test_picture_of_any_shape_is_not_distorted(draw, size):
    image = draw("sphere", "clipped", "coverage", size, camera={"orbit": {}})
    rows, columns = np.nonzero(image.pixels[:, :, 3] > 127)
    assert abs(np.ptp(rows) - np.ptp(columns)) <= 2
    assert abs(rows.mean() - (size[1] - 1) / 2) < 1
    assert abs(columns.mean() - (size[0] - 1) / 2) < 1


def test_many_frames_of_many_sizes_leave_nothing_behind(draw, gpu):
    rng = np.random.default_rng(5)
    rungs = [ALL_RUNGS[i] for i in rng.integers(0, len(ALL_RUNGS), 200)]
    for rung in ALL_RUNGS:
        draw("sphere", *rung, (600, 500))
    before = _names_in_use(gpu)
    for rung, (width, height) in zip(rungs, rng.integers(1, 600, (200, 2)), strict=True):
        draw("sphere", *rung, (int(width), int(height)))
    assert len(gpu.targets) <= 8
    assert len(gpu.targets) <= LEAST_TARGETS or gpu.targets.nbytes <= MOST_BYTES
    assert _names_in_use(gpu) == pytest.approx(before, abs=8)


def test_large_framebuffers_are_given_back_before_there_are_many(gpu):
    targets = Targets(gpu.gl)
    try:
        for step in range(8):
            latest = targets.get(1024 + 64 * step, 1024, 4)
        assert len(targets) == LEAST_TARGETS and targets.get(1024 + 64 * 7, 1024, 4) is latest
        for step in range(8):
            targets.get(64, 64 + 64 * step)
        assert len(targets) == 8 and targets.nbytes <= MOST_BYTES
    finally:
        targets.release()


def _names_in_use(gpu) -> list[int]:
    """Live buffers, textures, framebuffers, renderbuffers and vertex arrays."""
    counts = []
    for kind in ("Buffer", "Texture", "Framebuffer", "Renderbuffer", "VertexArray"):
        is_live = ctypes.CFUNCTYPE(ctypes.c_ubyte, ctypes.c_uint)(gpu.gl._native.load(f"glIs{kind}"))
        counts.append(sum(is_live(name) for name in range(1, 20000)))
    return counts


def test_cache_of_the_gl_keeps_within_its_bytes(draw, gpu):
    for name in SHAPES:
        for rung in ("clipped", "original"):
            draw(clippable(name), rung, "none", (32, 32))
            assert gpu.cache.nbytes <= 64 << 20


def test_outline_is_no_farther_off_than_the_picture_says(draw):
    camera, side, fine = VIEWS["orbit"], 64, 8
    binary = alpha(draw("knot", "original", "none", (side * fine, side * fine), camera=camera)) > 0.5
    for rung in ALL_RUNGS:
        image = draw("knot", *rung, (side, side), camera=camera)
        reach = int(np.ceil(image.error_px * fine)) + 1
        for inside, empty in ((binary, False), (~binary, True)):
            safe = eroded(inside, reach + fine)  # all of the pixel, and what its samples can mistake, is on one side
            whole = safe.reshape(side, fine, side, fine).any(axis=(1, 3))
            assert (image.pixels[:, :, 3][whole] == (0 if empty else 255)).all(), rung


def eroded(mask, steps):
    return binary_erosion(mask, np.ones((3, 3), bool), iterations=steps, border_value=1)


def test_others_run_while_a_picture_is_drawn(draw):
    ticks, done = [], threading.Event()

    def tick():
        while not done.wait(0.001):
            ticks.append(time.perf_counter())

    draw("bumpy", "original", "ssaa", (64, 64))
    ticker = threading.Thread(target=tick)
    ticker.start()
    start = time.perf_counter()
    draw("bumpy", "original", "ssaa", (1400, 1400))
    seconds = time.perf_counter() - start
    done.set()
    ticker.join()
    longest = max(np.diff([start, *ticks, start + seconds]))
    assert longest < 0.5 * seconds


def test_waiting_for_each_pass_changes_nothing_but_the_times(gpu):
    from schemas.render import RenderRequest

    request = RenderRequest(width=64, height=64)
    fast = frames.render_frame(gpu, clippable("knot"), request)
    waited = frames.render_frame(gpu, clippable("knot"), request, true_times=True)
    assert np.array_equal(fast.pixels, waited.pixels)
    assert fast.plan == waited.plan
    assert [name for name, _ in fast.passes] == list(fast.plan)
