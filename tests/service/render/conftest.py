from __future__ import annotations

import pytest

from schemas.render import Accuracy, RenderRequest, Shading
from service.render.frame import render_frame
from tests.service.render.lined import drawn_with_lines
from tests.service.render.made import clippable

VIEWS = {
    "orbit": {"orbit": {"azimuth_deg": 30, "elevation_deg": 20}},
    "above": {"orbit": {"azimuth_deg": -100, "elevation_deg": 75}},
    "close": {"eye": [1.3, 0.8, 1.7], "fov_y_deg": 60},
    "orthographic": {"eye": [3, 2, 4], "projection": "orthographic", "height": 2.6},
    "cropped": {"eye": [0.4, 0.3, 2.4], "target": [0.8, 0.3, 0], "fov_y_deg": 30},
}


@pytest.fixture
def draw(gpu):
    """Draws a shape, by name, or an asset."""

    def drawn(asset, source="auto", antialias="coverage", size=(128, 128), shading=None, **request):
        asset = clippable(asset) if isinstance(asset, str) else asset
        accuracy = Accuracy(source=source, antialias=antialias)
        shading = Shading(**(shading or {}))
        return render_frame(gpu, asset, RenderRequest(width=size[0], height=size[1], accuracy=accuracy, shading=shading, **request))

    return drawn


@pytest.fixture
def draw_lines(gpu):
    """Draws an asset's original with lines over it."""

    def drawn(asset, lines, **fields):
        return drawn_with_lines(gpu, asset, lines, **fields)

    return drawn
