from __future__ import annotations

from io import BytesIO

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from PIL import Image

from schemas.render import ImageFormat
from service.render.encode import encode

images = arrays(np.uint8, st.tuples(st.integers(1, 40), st.integers(1, 40), st.just(4)))


def decoded(data):
    image = Image.open(BytesIO(data))
    image.load()
    return image


@settings(deadline=None)  # compiling counts
@given(images)
def test_png_comes_back_as_it_was(pixels):
    image = decoded(encode(pixels, ImageFormat.PNG))
    assert image.mode == "RGBA"
    assert np.array_equal(np.asarray(image), pixels)


@settings(deadline=None)  # compiling counts
@given(images)
def test_raw_is_the_bytes(pixels):
    assert encode(pixels, ImageFormat.RAW) == pixels.tobytes()


def test_png_of_a_view_that_is_not_contiguous_is_right():
    pixels = np.random.default_rng(0).integers(0, 256, (40, 40, 4), np.uint8)[::2, 5:30]
    assert np.array_equal(np.asarray(decoded(encode(pixels, ImageFormat.PNG))), pixels)


def test_large_smooth_png_is_much_smaller_than_raw():
    ramp = np.zeros((512, 512, 4), np.uint8)
    ramp[:, :, 0] = np.arange(512) // 2
    ramp[:, :, 3] = 255
    assert len(encode(ramp, ImageFormat.PNG)) < ramp.nbytes / 50


def test_webp_keeps_colour_and_alpha_nearly():
    pixels = np.zeros((64, 64, 4), np.uint8)
    pixels[16:48, 16:48] = (200, 100, 50, 255)
    image = decoded(encode(pixels, ImageFormat.WEBP))
    back = np.asarray(image.convert("RGBA")).astype(int)
    assert image.format == "WEBP"
    assert np.array_equal(back[:, :, 3], pixels[:, :, 3])
    assert np.abs(back[24:40, 24:40] - pixels[24:40, 24:40]).max() <= 8


@pytest.mark.parametrize(("alpha", "expected"), [(0, 255), (255, 0), (128, 187)])
def test_jpeg_lies_on_white_in_linear_light(alpha, expected):
    pixels = np.zeros((32, 32, 4), np.uint8)
    pixels[:, :, 3] = alpha
    image = decoded(encode(pixels, ImageFormat.JPEG))
    assert image.format == "JPEG"
    assert image.mode == "RGB"
    assert np.abs(np.asarray(image).astype(int) - expected).max() <= 2
