"""Colours are filtered, interpolated, resolved and blended as light: half black and half white is byte 188, not 128."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from tests import meshes
from tests.service.render.made import SHAPES, prepared

FRONT = {"eye": [0, 0, 4], "fov_y_deg": 40}
BARE = {"ambient": 1.0}
HALF = 188
EVERY = [("clipped", "none"), ("clipped", "line"), ("clipped", "coverage"), ("original", "none"), ("original", "coverage"),
         ("original", "msaa"), ("original", "ssaa")]  # fmt: skip


def srgb(linear):
    c = np.asarray(linear, float)
    return 255.0 * np.where(c <= 0.0031308, 12.92 * c, 1.055 * np.maximum(c, 1e-9) ** (1 / 2.4) - 0.055)


def slab(n=8):
    """A flat box from -1 to 1 whose front shows what is asked of it; (vertices, faces)."""
    vertices, faces = meshes.cube(n)
    return (vertices - 0.5) * [2.0, 2.0, 0.4], faces


@cache
def ramp_of_vertices():
    """Black vertices on the left, white ones on the right."""
    mesh = slab(1)
    grey = (mesh[0][mesh[1]][:, :, 0] > 0) * 255
    color = np.concatenate([np.repeat(grey[:, :, None], 3, axis=2), np.full((*grey.shape, 1), 255)], axis=2)
    return prepared("vertex ramp", mesh, 200, {"corner_color": color.astype(np.uint8)})


@cache
def ramp_of_texels():
    """The same, by a texture of two texels whose centres lie at the sides."""
    mesh = slab(1)
    texture = np.array([[[0, 0, 0, 255], [255, 255, 255, 255]]], np.uint8)
    uv = np.zeros((len(mesh[1]), 3, 2), np.float32)
    uv[:, :, 0] = mesh[0][mesh[1]][:, :, 0] * 0.25 + 0.5
    uv[:, :, 1] = 0.5
    return prepared("texel ramp", mesh, 200, {"corner_uv": uv, "texture": texture})


@pytest.mark.parametrize("rung", EVERY)
@pytest.mark.parametrize("made", [ramp_of_vertices, ramp_of_texels])
def test_between_black_and_white_the_light_is_linear(draw, made, rung):
    image = draw(made(), *rung, (129, 129), BARE, camera=FRONT)
    row = image.pixels[64]
    inside = np.flatnonzero(row[:, 3] == 255)[2:-2]
    assert len(inside) > 60
    middle = row[64, :3].astype(int)
    assert np.abs(middle - HALF).max() <= 4
    across = (inside - 64) / (2 * np.abs(inside - 64).max() + 5.0) + 0.5
    assert np.abs(row[inside, 1] - srgb(across)).max() <= 14
    assert np.abs(row[inside, 1] - srgb(across))[len(inside) // 3 :].max() <= 5


@cache
def halves():
    """White on the right, black on the left."""
    mesh = slab(8)
    grey = np.where(mesh[0][mesh[1]].mean(axis=1)[:, 0] > 0, 255, 0)
    color = np.repeat(np.stack([grey, grey, grey, np.full(len(grey), 255)], axis=1)[:, None], 3, axis=1)
    return prepared("halves", mesh, 200, {"corner_color": color.astype(np.uint8)})


@pytest.mark.parametrize("antialias", ["msaa", "ssaa"])
def test_samples_are_resolved_as_light(draw, antialias):
    """An odd number of columns: the border between the halves is in the middle of one."""
    row = draw(halves(), "original", antialias, (129, 129), BARE, camera=FRONT).pixels[64]
    assert row[62, 0] == 0
    assert row[66, 0] == 255
    assert np.abs(row[64, :3].astype(int) - HALF).max() <= 1


@pytest.mark.parametrize("rung", [rung for rung in EVERY if rung[1] not in ("none", "line")])
def test_black_half_covered_over_white_is_half_the_light(draw, rung):
    """64 pixels about the middle of the 65th column: both sides of the slab fall in the middle of one."""
    camera = {"eye": [0, 0, 4], "projection": "orthographic", "height": 2.0 * 129 / 64}
    image = draw(halves(), *rung, (129, 129), {"color": "#000000", "use_mesh_color": False} | BARE, camera=camera, background="#ffffff")
    half = np.abs(image.pixels[64, :, :3].astype(int) - HALF).max(axis=1) <= 2
    assert half.sum() == 2


def test_alpha_of_the_mesh_own_colours_is_not_drawn(draw):
    """Pictures are opaque; the maps keep it for other viewers."""
    mesh = SHAPES["sphere"]()
    color = np.full((len(mesh[1]), 3, 4), (200, 100, 50, 0), np.uint8)
    asset = prepared("glass", mesh, 200, {"corner_color": color})
    assert (asset.maps["color"][..., 3] == 0).all()
    for rung in EVERY:
        image = draw(asset, *rung, shading=BARE, camera=FRONT)
        assert image.pixels[64, 64].tolist() == [200, 100, 50, 255], rung
