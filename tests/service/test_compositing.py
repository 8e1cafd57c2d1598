from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from service.kernels.compositing import linear_table, put_drawn, put_flat, put_masked

TABLE = linear_table()
SIZE = (5, 7)
images = arrays(np.uint8, (*SIZE, 4))
masks = arrays(np.uint8, SIZE)
colors = st.tuples(*[st.integers(0, 255)] * 3)


def words(pixels):
    return pixels.view("<u4")[:, :, 0]


def ground_of(color):
    return np.tile(np.array([*color, 255], np.uint8), (*SIZE, 1))


def over(front, alpha, ground):
    """The same in float64, straight from the definition."""
    table = np.arange(256) / 255.0
    table = np.where(table <= 0.04045, table / 12.92, ((table + 0.055) / 1.055) ** 2.4)
    a = alpha[:, :, None] / 255.0
    linear = table[front] * a + table[ground] * (1.0 - a)
    return 255.0 * np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)


@settings(deadline=None)  # compiling counts
@given(images, masks, colors)
def test_masked_pixels_are_blended_in_linear_light(drawn, mask, color):
    out = ground_of(color)
    put_masked(words(drawn), mask, words(out), True, TABLE)
    assert (out[:, :, 3] == 255).all()
    assert np.abs(out[:, :, :3] - over(drawn[:, :, :3], mask, ground_of(color)[:, :, :3])).max() < 0.51


@settings(deadline=None)  # compiling counts
@given(images, masks)
def test_on_nothing_colour_stays_and_the_mask_is_alpha(drawn, mask):
    out = np.zeros((*SIZE, 4), np.uint8)
    put_masked(words(drawn), mask, words(out), False, TABLE)
    assert np.array_equal(out[:, :, 3], mask)
    assert np.array_equal(out[mask > 0][:, :3], drawn[mask > 0][:, :3])
    assert not out[mask == 0].any()


@settings(deadline=None)  # compiling counts
@given(images, colors)
def test_drawn_pixels_bring_their_own_alpha(drawn, color):
    out = ground_of(color)
    put_drawn(words(drawn), words(out), True, TABLE)
    expected = np.where(drawn[:, :, 3:] == 0, ground_of(color)[:, :, :3], over(drawn[:, :, :3], drawn[:, :, 3], ground_of(color)[:, :, :3]))
    assert np.abs(out[:, :, :3] - expected).max() < 0.51
    bare = np.zeros((*SIZE, 4), np.uint8)
    put_drawn(words(drawn), words(bare), False, TABLE)
    assert np.array_equal(bare, drawn)


@settings(deadline=None)  # compiling counts
@given(colors, masks, st.booleans())
def test_flat_colour_is_a_mask_over_one_colour(color, mask, opaque):
    drawn, expected, out = ground_of(color), ground_of((9, 99, 199)) * opaque, ground_of((9, 99, 199)) * opaque
    put_masked(words(drawn), mask, words(expected), opaque, TABLE)
    put_flat(words(drawn)[0, 0], mask, words(out), opaque, TABLE)
    assert np.array_equal(out, expected)
