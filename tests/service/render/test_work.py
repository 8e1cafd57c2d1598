"""A frame does what its scene calls for and nothing else: passes, draw calls, bytes given to the GL."""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np
import pytest

from schemas.render import Accuracy, ProjectTo, RenderRequest, Shading, SilhouetteRequest
from service.render.frame import render_frame
from service.silhouette.describe import describe_silhouette
from service.silhouette.document import silhouette_json
from tests import meshes
from tests.service.render.laddered import many_ways
from tests.service.render.made import clippable, prepared, unclippable

GL = {"clear", "stencil", "surface", "rim", "interior", "outline", "resolve", "read"}
ASIDE = {"eye": [0.0, 0.0, 9.0], "target": [0.0, 0.0, 20.0]}


@pytest.fixture
def drawn(gpu):
    """Draws a frame whose surfaces and programs the GL has already, so that what is counted is the frame's own."""

    def draw(asset, mode="lambert", camera=None, **accuracy):
        more = {} if camera is None else {"camera": camera}
        request = RenderRequest(width=96, height=96, accuracy=Accuracy(**accuracy), shading=Shading(mode=mode), **more)
        render_frame(gpu, asset, request)
        return render_frame(gpu, asset, request, true_times=True)

    return draw


TABLE = [
    # asset, request, draw calls, whether anything is given to the GL, passes of the GL
    ("sphere", {}, 0, False, set()),
    ("sphere", {"mode": "mask"}, 0, False, set()),
    ("sphere", {"smooth": True}, 0, False, set()),
    ("sphere", {"camera": ASIDE}, 0, False, set()),
    ("sphere", {"camera": ASIDE, "antialias": "msaa"}, 0, False, set()),
    ("sphere", {"source": "original", "antialias": "none"}, 1, False, {"clear", "surface", "read"}),
    ("sphere", {"antialias": "msaa"}, 2, False, {"clear", "surface", "resolve", "read"}),
    ("sphere", {"antialias": "ssaa"}, 2, False, {"clear", "surface", "resolve", "read"}),
    ("sphere", {"antialias": "none"}, 2, True, {"clear", "stencil", "surface", "read"}),
    ("sphere", {"antialias": "none", "mode": "mask"}, 2, True, {"clear", "stencil", "interior", "read"}),
    ("sphere", {"antialias": "line"}, 6, True, {"clear", "stencil", "surface", "rim", "interior", "outline", "read"}),
    ("sphere", {"source": "original", "antialias": "coverage"}, 2, True, {"clear", "surface", "rim", "read"}),
    ("open", {}, 2, False, {"clear", "surface", "resolve", "read"}),
    ("open", {"antialias": "none"}, 1, False, {"clear", "surface", "read"}),
]


@pytest.mark.parametrize(("name", "request_fields", "draws", "uploads", "passes"), TABLE)
def test_a_frame_does_exactly_this_work(drawn, name, request_fields, draws, uploads, passes):
    image = drawn(unclippable() if name == "open" else clippable(name), **request_fields)
    assert set(image.plan) & (GL if draws else {"clear", "read"}) == passes
    assert {name for name, _ in image.passes} == set(image.plan)
    assert image.work.draws == draws
    assert (image.work.uploaded_bytes > 0) == uploads


def test_off_screen_nothing_runs_but_the_background(drawn):
    assert drawn(clippable("sphere"), camera=ASIDE).plan == ("background",)
    assert drawn(clippable("sphere"), camera=ASIDE, antialias="line", mode="mask").plan == ("background",)


def test_an_effect_adds_its_work_and_no_other(drawn):
    asset = clippable("torus")
    plain, lined = drawn(asset, antialias="none"), drawn(asset, antialias="line")
    assert set(lined.plan) - set(plain.plan) == {"segments", "rim", "interior", "outline"}
    assert lined.work.draws - plain.work.draws == 4  # the rim, the interior, the outline from both sides
    original, resolved = drawn(asset, antialias="none", source="original"), drawn(asset, antialias="msaa")
    assert set(resolved.plan) - set(original.plan) == {"resolve"}
    assert resolved.work.draws - original.work.draws == 1


def test_a_coarser_outline_gives_the_gl_less(drawn):
    asset = many_ways("bumpy")
    uploads = [
        drawn(asset, antialias="none", source="clipped", level=level).work.uploaded_bytes for level in (-1, 0, len(asset.levels) - 1)
    ]
    assert uploads == sorted(uploads, reverse=True) and uploads[0] > uploads[-1]


def test_colours_are_given_to_the_gl_only_where_there_are_and_are_wanted(gpu):
    vertices, faces = meshes.sphere(2)
    appearance = {"corner_color": np.full((len(faces), 3, 4), 200, np.uint8)}
    tinted, plain = prepared("tinted", (vertices, faces), 60, appearance), prepared("plain", (vertices, faces), 60, None)

    def uploaded(asset, **shading):
        """Of the first frame of the asset, which nothing in the GL is of."""
        unseen = replace(asset, id=f"{asset.id} {sorted(shading.items())}")
        request = RenderRequest(width=32, height=32, accuracy=Accuracy(source="original", antialias="none"), shading=Shading(**shading))
        return render_frame(gpu, unseen, request).work.uploaded_bytes

    assert uploaded(tinted) > uploaded(plain) == uploaded(tinted, use_mesh_color=False) == uploaded(tinted, mode="normal")


def test_a_silhouette_as_json_gives_the_gl_nothing(gpu):
    before = gpu.gl.work
    silhouette_json(describe_silhouette(clippable("knot"), SilhouetteRequest(project=ProjectTo())))
    assert gpu.gl.work == before


def test_times_of_passes_make_up_the_frame_and_drawing_is_not_charged_to_reading(gpu):
    vertices, faces = meshes.bumpy_sphere(6, 0.4)
    asset = prepared("heavy", (vertices, faces), 300, None)
    for antialias in ("none", "msaa"):
        request = RenderRequest(width=256, height=256, accuracy=Accuracy(source="original", antialias=antialias))
        shares, reading = [], []
        for _ in range(6):
            start = time.perf_counter()
            image = render_frame(gpu, asset, request, true_times=True)
            wall = (time.perf_counter() - start) * 1e3
            passes = dict(image.passes)
            shares.append(sum(passes.values()) / wall)
            reading.append(passes["read"] / passes["surface"])
        assert 0.85 < sorted(shares)[3] <= 1.0
        assert sorted(reading)[3] < 0.3


def test_gl_timers_where_they_are_used_are_asked_for_every_pass_that_draws(gpu, monkeypatch):
    asked = []
    real = gpu.gl.timed
    monkeypatch.setattr(gpu.gl, "timed", lambda: asked.append(real()) or asked[-1])
    monkeypatch.setattr(gpu.gl, "has_timers", True)
    for antialias in ("none", "line", "msaa"):
        image = render_frame(
            gpu, clippable("knot"), RenderRequest(width=96, height=96, accuracy=Accuracy(antialias=antialias)), true_times=True
        )
        passes = dict(image.passes)
        assert set(passes) == set(image.plan) and all(ms >= 0.0 for ms in passes.values())
        assert len(asked) == len(set(passes) & (GL - {"read"}))
        asked.clear()
    gpu.gl.check()
