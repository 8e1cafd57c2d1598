"""Maps of fewer texels, for pictures in which a texel of the full ones is less than a pixel."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from geometry.tile_layout import TileLayout
from service.kernels.compositing import linear_table, srgb_of
from service.kernels.halve_tiles import halve_tiles, tents

_LINEAR = linear_table().astype(np.float64)
_ENCODED = srgb_of(np.linspace(0.0, 1.0, 1 << 16))
"""sRGB of each amount of linear light; steps of a twentieth of a byte at the darkest."""


def halved_maps(maps: Mapping[str, Any], halvings: int) -> dict[str, Any]:
    """Tensors of `artifacts.MAPS`, the sides of their tiles halved so often; the same maps for none."""
    if not halvings:
        return dict(maps)
    normal = maps["normal"]
    layout = TileLayout.of(maps["tile_uv"], normal.shape[1], normal.shape[0])
    small = layout.halved(halvings)
    taps = tents(layout.side, small.side)
    scratch = np.zeros((layout.side + 1, layout.side + 1, 4)), np.zeros((small.side + 2, small.side + 2, 4))
    made: dict[str, Any] = {"tile_uv": small.tile_uv(layout.turns(maps["tile_uv"]))}
    for name, empty in (("normal", (128, 128, 255)), ("color", (0, 0, 0, 0))):
        if name in maps:
            made[name] = np.full((small.height, small.width, len(empty)), empty, np.uint8)
            image = np.array(maps[name], np.uint8)  # one array type for the compiler
            light = (name == "color", _LINEAR, _ENCODED)
            halve_tiles(image, layout.faces, layout.side, layout.columns, small.side, taps, light, scratch, made[name])
    return made
