"""Maps of fewer texels, for pictures in which a texel of the full ones is less than a pixel."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

MOST_HALVINGS = 2


def halved_maps(maps: Mapping[str, Any], halvings: int) -> dict[str, Any]:
    """Tensors of `artifacts.MAPS`, their tiles' sides halved so often; the same maps for none."""
    if halvings:
        raise ValueError("maps are not halved")
    return dict(maps)
