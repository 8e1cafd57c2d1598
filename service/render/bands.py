"""Bands of rows, drawn side by side where a picture needs no GL."""

from __future__ import annotations

import math
from itertools import pairwise

from service.render.state import Tile
from service.threads import cores

LEAST_PIXELS = 1 << 13
"""A band with fewer takes less time than waking a thread for it."""
MOST_PIXELS = 1 << 22
"""Bounds the memory of a band whatever the size of the image."""
BANDS_A_CORE = 2
"""More balance the work better, and each costs some setting up."""


def bands_of(area: Tile) -> list[Tile]:
    """Bands that cover a rectangle of the image from top to bottom, as wide as it; none when it is empty."""
    pixels = area.width * area.height
    if not pixels:
        return []
    count = min(BANDS_A_CORE * cores(), pixels // LEAST_PIXELS) if cores() > 1 else 1
    count = min(max(count, math.ceil(pixels / MOST_PIXELS), 1), area.height)
    edges = [area.y + area.height * i // count for i in range(count + 1)]
    return [Tile(area.x, low, area.width, high - low) for low, high in pairwise(edges)]
