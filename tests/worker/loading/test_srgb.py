"""Colours are mixed as light, not as bytes."""

import numpy as np
import pytest
from PIL import Image

from worker.loading.srgb import BAND_PIXELS, LINEAR, encoded, multiplied, resized


def test_every_byte_comes_back():
    assert np.array_equal(encoded(LINEAR), np.arange(256))


def test_product_is_one_of_light():
    dark = np.array([[64, 128, 255, 255]], np.uint8)
    expected = encoded(LINEAR[dark[:, :3]] ** 2)
    assert np.array_equal(multiplied(dark, dark)[:, :3], expected)
    assert expected[0].tolist() == [9, 61, 255]  # of bytes it would be 16, 64, 255
    assert multiplied(np.array([255, 255, 255, 128], np.uint8), np.array([255, 255, 255, 128], np.uint8))[3] == 64


@pytest.mark.parametrize("size", [(32, 16), (8, 8), (1, 1), (11, 5)])
def test_black_and_white_texels_become_half_the_light(size):
    board = np.full((64, 64, 4), 255, np.uint8)
    board[..., :3] = (np.add.outer(np.arange(64), np.arange(64)) % 2 * 255)[..., None]
    small = resized(Image.fromarray(board), *size)
    assert small.shape == (size[1], size[0], 4)
    assert abs(LINEAR[small[..., :3]].mean() - 0.5) < 0.02
    if 64 % size[0] == 0 and 64 % size[1] == 0:
        assert (small == (188, 188, 188, 255)).all()


def test_transparent_texels_lend_no_colour():
    picture = np.zeros((2, 2, 4), np.uint8)
    picture[0] = (200, 40, 10, 255)
    picture[1] = (0, 255, 0, 0)
    assert resized(Image.fromarray(picture), 1, 1)[0, 0].tolist() == [200, 40, 10, 128]


def test_bands_meet_without_a_seam(monkeypatch):
    rng = np.random.default_rng(0)
    picture = Image.fromarray(rng.integers(0, 256, (90, 40, 4)).astype(np.uint8))
    whole = resized(picture, 13, 31)
    monkeypatch.setattr("worker.loading.srgb.BAND_PIXELS", 40 * 9)
    assert BAND_PIXELS > 40 * 90
    assert np.abs(resized(picture, 13, 31).astype(int) - whole).max() <= 1
