from __future__ import annotations

import pytest

from benchmarks import line_pixels
from benchmarks.frame import alpha, outline_error, prepare, request
from schemas.lines import LineMethod
from schemas.mesh import PreprocessOptions
from schemas.render import Antialias, Source
from tests.meshes import shared

pytestmark = pytest.mark.heavy
TEXELS = 64
"""Coverage is asked about, which maps have no part in."""


def test_outline_of_the_bunny_is_that_of_its_supersampled_original(gpu):
    asset = prepare(shared("bunny_closed.ply"), PreprocessOptions(texels=TEXELS))
    error = outline_error(gpu, asset, 4, 512)
    assert error["mean_abs_error_edge_pixels"] <= 0.005
    assert error["wrong_other_pixels_percent"] <= 0.01


@pytest.mark.parametrize("name", ["fandisk.ply", "cube_gears.3mf", "conrod.stl"])
def test_clipped_pixels_are_those_of_the_original(gpu, name):
    asset = prepare(shared(name), PreprocessOptions(texels=TEXELS))
    differing = 0
    for view in range(6):
        clipped, original = (
            alpha(gpu, asset, request(view, 6, 256, (source, Antialias.NONE))) for source in (Source.CLIPPED, Source.ORIGINAL)
        )
        assert original.any()
        differing += int((clipped != original).sum())
    assert differing <= 3


@pytest.mark.parametrize("name", ["fandisk.ply", "rocker_arm.ply", "bunny_closed.ply"])
def test_lines_of_every_method_are_the_exact_visible_silhouette(gpu, name):
    """Translated faces are as wide as they are: of them more is explained by less, and what they leave out is less than a percent."""
    found = line_pixels.measure(gpu, str(shared(name)), views=4, side=512)
    for method in LineMethod:
        least = line_pixels.BAR - (0.5 if method is LineMethod.TRANSLATED else 0.0)
        assert found[method.value]["explained"] >= line_pixels.BAR, method
        assert found[method.value]["found"] >= least, method
