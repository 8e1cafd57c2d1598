"""The reference is the mean of all samples, whatever the tiles."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from schemas.render import Accuracy, Orbit, OrbitCamera, RenderRequest
from service.kernels.picture_errors import reduce_samples
from service.measure.reference import reference
from service.render.frame import TILE_SAMPLES, render_frame
from service.render.state import LINEAR_TABLE
from tests.service.render.made import clippable, unclippable
from tests.service.render.test_color import ramp_of_texels, ramp_of_vertices

CAMERA = OrbitCamera(orbit=Orbit(azimuth_deg=30.0, elevation_deg=20.0))
ACROSS_TILES = 160


def brute_force(gpu, asset, side, samples=16):
    """(side, side, 4) f8: a picture of as many pixels as there are samples, averaged by numpy."""
    request = RenderRequest(
        camera=CAMERA, width=side * samples, height=side * samples, accuracy=Accuracy(source="original", antialias="none")
    )
    pixels = render_frame(gpu, asset, request).pixels
    light = LINEAR_TABLE.astype(np.float64)[pixels[:, :, :3]] * (pixels[:, :, 3:] == 255)
    every = np.concatenate([light, pixels[:, :, 3:] / 255.0], axis=2)
    return every.reshape(side, samples, side, samples, 4).mean(axis=(1, 3))


@pytest.mark.parametrize("asset", [lambda: clippable("knot"), ramp_of_vertices, ramp_of_texels, unclippable])
def test_it_is_the_mean_of_a_picture_of_sixteen_times_the_sides(gpu, asset):
    made, expected = reference(gpu, asset(), CAMERA, 24), brute_force(gpu, asset(), 24)
    # drawn in another tile, a sample now and then is a byte brighter
    np.testing.assert_allclose(made[:, :, :3], expected[:, :, :3], atol=1e-4)
    assert np.array_equal(made[:, :, 3], expected[:, :, 3])
    assert 0.1 < made[:, :, 3].mean() < 0.9


def test_tiles_leave_no_seam(gpu):
    assert ACROSS_TILES * 16 > TILE_SAMPLES
    made, expected = reference(gpu, clippable("torus"), CAMERA, ACROSS_TILES), brute_force(gpu, clippable("torus"), ACROSS_TILES)
    off = np.abs(made - expected)
    # float32 matrices of other tiles place vertices a ten thousandth of a sample elsewhere
    assert off[:, :, 3].max() <= 1.0 / 256.0 and (off[:, :, 3] > 0).sum() <= 4
    assert off[:, :, :3].max() <= 1.0 / 256.0 + 1e-5


def test_alpha_counts_samples_exactly(gpu):
    alpha = reference(gpu, clippable("bumpy"), CAMERA, 32)[:, :, 3]
    assert np.array_equal(alpha * 256.0, np.round(alpha * 256.0))
    assert len(np.unique(alpha)) > 40


@settings(deadline=None)  # compiles
@given(
    arrays.arrays(np.uint8, st.tuples(st.integers(1, 3), st.integers(1, 3), st.just(16), st.just(4))),
    arrays.arrays(np.bool_, (3, 3, 16)),
)
def test_a_block_is_the_mean_of_its_samples(colors, covered):
    height, width = colors.shape[:2]
    covered = covered[:height, :width]
    samples = np.where(covered[..., None], np.concatenate([colors[..., :3], np.full_like(colors[..., :1], 255)], axis=3), 0)
    grid = samples.reshape(height, width, 4, 4, 4).transpose(0, 2, 1, 3, 4).reshape(4 * height, 4 * width, 4)
    out = np.full((height, width, 4), np.nan, np.float32)
    reduce_samples(np.ascontiguousarray(grid).view("<u4")[:, :, 0], 4, LINEAR_TABLE, out)
    light = LINEAR_TABLE.astype(np.float64)[samples[..., :3]] * covered[..., None]
    np.testing.assert_allclose(out[:, :, :3], light.mean(axis=2), atol=1e-6)
    assert np.array_equal(out[:, :, 3], covered.mean(axis=2))
