"""OVER in linear light, rounded once."""

from __future__ import annotations

import numpy as np
import pytest

from service.kernels.compositing import linear_table, put_drawn
from service.kernels.layers import put_over, settle

TABLE = linear_table()


def linear(byte):
    c = byte / 255.0
    return np.where(c <= 0.04045, c / 12.92, ((c + 0.055) / 1.055) ** 2.4)


def srgb(c):
    return np.where(c <= 0.0031308, 12.92 * c, 1.055 * np.maximum(c, 0.0) ** (1 / 2.4) - 0.055) * 255.0


def over(image, *layers):
    """The kernels' picture of layers (h, w, 4) u1, the farthest first."""
    out = image.copy()
    mixed, light = np.zeros(out.shape[:2], np.uint8), np.empty(out.shape, np.float32)
    for layer in layers:
        height, width = layer.shape[:2]
        put_over(layer.view("<u4")[:, :, 0], 0, 0, width, height, out.view("<u4")[:, :, 0], mixed, light, TABLE)
    settle(out.view("<u4")[:, :, 0], mixed, light)
    return out


def layers(count, seed, shape=(40, 50)):
    """Random layers with whole, empty and partial pixels."""
    rng = np.random.default_rng(seed)
    made = rng.integers(0, 256, (count, *shape, 4), np.uint8)
    kind = rng.integers(0, 3, (count, *shape))
    made[..., 3] = np.where(kind == 0, 0, np.where(kind == 1, 255, np.clip(made[..., 3], 1, 254)))
    made[made[..., 3] == 0] = 0
    return made


@pytest.mark.parametrize("ground", [0, 255])
@pytest.mark.parametrize("count", [1, 2, 9])
def test_layers_are_composited_as_in_exact_arithmetic(count, ground):
    background = np.zeros((40, 50, 4), np.uint8) if ground == 0 else np.full((40, 50, 4), (30, 90, 200, 255), np.uint8)
    made = layers(count, 7 * count + ground)
    color, alpha = linear(background[..., :3].astype(float)) * (background[..., 3:] / 255.0), background[..., 3] / 255.0
    for layer in made:
        a = layer[..., 3] / 255.0
        color = linear(layer[..., :3].astype(float)) * a[..., None] + color * (1 - a[..., None])
        alpha = a + alpha * (1 - a)
    out = over(background, *made)
    assert np.abs(out[..., 3] - alpha * 255.0).max() < 0.501
    some = alpha > 0
    assert np.abs(out[some][:, :3] - srgb(color[some] / alpha[some][:, None])).max() < 0.51
    assert not out[~some].any()


def test_a_single_layer_on_nothing_stays_what_it_is():
    alpha, byte = np.meshgrid(np.arange(1, 256), np.arange(256), indexing="ij")
    layer = np.stack([byte, 255 - byte, byte // 2, alpha], axis=-1).astype(np.uint8)
    assert np.array_equal(over(np.zeros_like(layer), layer), layer)


def test_a_single_layer_on_a_background_is_the_picture_of_one_mesh():
    layer = layers(1, 3)[0]
    for color in ((0, 0, 0), (255, 255, 255), (30, 90, 200)):
        background = np.full((40, 50, 4), (*color, 255), np.uint8)
        expected = background.copy()
        put_drawn(layer.view("<u4")[:, :, 0], expected.view("<u4")[:, :, 0], True, TABLE)
        assert np.array_equal(over(background, layer), expected)


def test_an_opaque_layer_hides_what_was_mixed_below():
    below, top = layers(1, 11)[0], layers(1, 12)[0]
    top[..., 3] = 255
    assert np.array_equal(over(np.zeros_like(below), below, top), top)


def test_only_the_rectangle_of_a_layer_counts():
    layer = layers(1, 4)[0]
    layer[..., 3] = 255
    out = np.zeros_like(layer)
    mixed, light = np.zeros(out.shape[:2], np.uint8), np.empty(out.shape, np.float32)
    put_over(layer.view("<u4")[:, :, 0], 5, 7, 20, 30, out.view("<u4")[:, :, 0], mixed, light, TABLE)
    assert np.array_equal(out[7:30, 5:20], layer[7:30, 5:20])
    out[7:30, 5:20] = 0
    assert not out.any()
