from __future__ import annotations

import pytest

from benchmarks.frame import alpha, outline_error, prepare, request
from schemas.mesh import PreprocessOptions
from schemas.render import Antialias, Source
from tests.meshes import shared

pytestmark = pytest.mark.heavy


def test_outline_of_the_bunny_is_that_of_its_supersampled_original(gpu):
    asset = prepare(shared("bunny_closed.ply"), PreprocessOptions())
    error = outline_error(gpu, asset, 4, 512)
    assert error["mean_abs_error_edge_pixels"] <= 0.005
    assert error["wrong_other_pixels_percent"] <= 0.01


@pytest.mark.parametrize("name", ["fandisk.ply", "cube_gears.3mf", "conrod.stl"])
def test_clipped_pixels_are_those_of_the_original(gpu, name):
    asset = prepare(shared(name), PreprocessOptions())
    differing = 0
    for view in range(6):
        clipped, original = (
            alpha(gpu, asset, request(view, 6, 256, (source, Antialias.NONE))) for source in (Source.CLIPPED, Source.ORIGINAL)
        )
        assert original.any()
        differing += int((clipped != original).sum())
    assert differing <= 3
