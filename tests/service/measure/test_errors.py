"""Errors of pictures against slow definitions."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from schemas.ladder import ShadingError
from service.measure.errors import MOST_DB, outline_error, outline_of, shading_error, shading_of

SHAPE = (6, 7)
MADE = arrays.arrays(np.uint8, SHAPE, elements=st.sampled_from([0, 0, 0, 51, 127, 128, 200, 255, 255, 255]))
TRUE = arrays.arrays(np.float32, SHAPE, elements=st.sampled_from([0.0, 0.0, 0.0, 0.25, 0.5, 0.75, 1.0, 1.0, 1.0]))
LUMA = np.array([0.2126, 0.7152, 0.0722])


def picture(alpha, color=0):
    pixels = np.zeros((*alpha.shape, 4), np.uint8)
    pixels[:, :, :3] = color
    pixels[:, :, 3] = alpha
    return pixels


def reference(alpha, light=0.0):
    pixels = np.zeros((*alpha.shape, 4), np.float32)
    pixels[:, :, :3] = np.asarray(light) * alpha[:, :, None]
    pixels[:, :, 3] = alpha
    return pixels


def encoded(linear):
    """0..255, not rounded."""
    c = np.asarray(linear, float)
    return 255.0 * np.where(c <= 0.0031308, 12.92 * c, 1.055 * np.maximum(c, 1e-9) ** (1 / 2.4) - 0.055)


def slow_distance(made, true):
    """The definition in `service.measure.errors`, pixel by pixel."""
    largest = np.abs(made / 255.0 - true).max()
    for y, x in np.ndindex(made.shape):
        if (true[y, x] == 0.0 and made[y, x] > 127) or (true[y, x] == 1.0 and made[y, x] < 128):
            others = np.argwhere(true != true[y, x])
            largest = max(largest, np.hypot(*(others - (y, x)).T).min() if len(others) else math.hypot(*SHAPE))
    return largest


@settings(deadline=None)  # compiles
@given(MADE, TRUE)
def test_outline_errors_are_as_defined(made, true):
    found = outline_of(picture(made), reference(true))
    off = np.abs(made / 255.0 - true)
    boundary = (true > 0.0) & (true < 1.0)
    assert found.error == pytest.approx(off[boundary].sum(), abs=1e-9)
    assert found.squares == pytest.approx((off[boundary] ** 2).sum(), abs=1e-9)
    assert (found.boundary, found.wrong) == (boundary.sum(), (off > 0.5).sum())
    assert found.distance_px == pytest.approx(slow_distance(made, true), abs=1e-9)


@pytest.mark.parametrize("by", [1, 2, 5])
def test_a_disk_that_is_larger_is_as_far_off_as_it_is_larger(by):
    y, x = np.mgrid[:48, :48] - 23.5
    radius = np.hypot(x, y)
    exact = np.clip(16.0 - radius + 0.5, 0.0, 1.0).astype(np.float32)
    larger = np.round(255.0 * np.clip(16.0 + by - radius + 0.5, 0.0, 1.0)).astype(np.uint8)
    assert outline_of(picture(larger), reference(exact)).distance_px == pytest.approx(by, abs=0.75)


def test_sums_of_pictures_are_put_together_pixel_by_pixel():
    few = outline_of(picture(np.array([[255, 255], [255, 255]], np.uint8)), reference(np.array([[0.5, 0.0], [1.0, 1.0]], np.float32)))
    many = outline_of(picture(np.array([[127, 127], [127, 0]], np.uint8)), reference(np.array([[0.5, 0.5], [0.5, 0.0]], np.float32)))
    both = outline_error([few, many])
    assert both.alpha_error == pytest.approx((0.5 + 3 * (0.5 - 127 / 255)) / 4)
    assert both.alpha_rmse == pytest.approx(math.sqrt((0.25 + 3 * (0.5 - 127 / 255) ** 2) / 4))
    assert (both.distance_px, both.wrong_pixels) == (1.0, 0.5)


def slow_ssim(a, b, counts):
    """Wang et al. 2004 with explicit windows of 11 x 11 that only see what counts."""
    c1, c2 = (0.01 * 255) ** 2, (0.03 * 255) ** 2
    values = []
    for y, x in np.argwhere(counts):
        ys, xs = np.mgrid[max(y - 5, 0) : min(y + 6, a.shape[0]), max(x - 5, 0) : min(x + 6, a.shape[1])]
        w = np.exp(-((ys - y) ** 2 + (xs - x) ** 2) / (2 * 1.5**2)) * counts[ys, xs]
        w /= w.sum()
        p, q = a[ys, xs], b[ys, xs]
        mp, mq = (w * p).sum(), (w * q).sum()
        vp, vq, pq = (w * p * p).sum() - mp**2, (w * q * q).sum() - mq**2, (w * p * q).sum() - mp * mq
        values.append((2 * mp * mq + c1) * (2 * pq + c2) / ((mp**2 + mq**2 + c1) * (vp + vq + c2)))
    return np.mean(values)


@pytest.mark.parametrize("seed", range(4))
def test_shading_errors_are_as_defined(seed):
    rng = np.random.default_rng(seed)
    light = rng.uniform(0, 1, (17, 19, 3))
    true = reference(rng.choice(np.array([0.0, 0.5, 1.0, 1.0, 1.0], np.float32), (17, 19)), light)
    made = picture(rng.choice([0, 255, 255, 255, 255], (17, 19)), np.clip(encoded(light) + rng.normal(0, 20, light.shape), 0, 255))
    counts = (made[:, :, 3] == 255) & (true[:, :, 3] == 1.0)
    found = shading_error([shading_of(made, true)])
    off = made[counts][:, :3] - encoded(light)[counts]
    assert found.psnr_db == pytest.approx(10 * math.log10(255**2 / (off**2).mean()), abs=1e-3)
    assert found.ssim == pytest.approx(slow_ssim(made[:, :, :3] @ LUMA, encoded(light) @ LUMA, counts), abs=1e-4)
    assert found.ssim < 0.99


def test_what_is_not_covered_fully_does_not_count_as_shading():
    true = reference(np.array([[1.0, 1.0, 0.5, 0.0]] * 3, np.float32), 0.5)
    made = picture(np.array([[255, 254, 255, 255]] * 3, np.uint8), 7)
    made[:, 0, :3] = np.round(encoded(0.5))
    found = shading_error([shading_of(made, true)])
    assert found.psnr_db > 50.0
    assert found.ssim == pytest.approx(1.0, abs=1e-4)


def test_pictures_that_are_the_same_have_a_finite_ratio():
    assert shading_error([shading_of(picture(np.full((3, 3), 255)), reference(np.ones((3, 3))))]) == ShadingError(psnr_db=MOST_DB, ssim=1.0)


def test_a_view_without_full_pixels_has_no_say():
    nothing = shading_of(picture(np.zeros((3, 3))), reference(np.ones((3, 3))))
    some = shading_of(picture(np.full((3, 3), 255), 10), reference(np.ones((3, 3))))
    assert nothing.pixels == 0
    assert shading_error([nothing, some]) == shading_error([some]) != shading_error([nothing])
    assert shading_error([nothing]) == ShadingError(psnr_db=MOST_DB, ssim=1.0)
