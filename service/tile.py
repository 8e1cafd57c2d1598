"""Rectangles of an image."""

from __future__ import annotations

import math
from dataclasses import dataclass

BORDER = 2
"""Pixels about the bounds of a surface that are drawn too: rim and outline reach one pixel beyond it."""


@dataclass(frozen=True)
class Tile:
    """A rectangle of the image, pixels from the top left. Empty ones have no width and no height."""

    x: int
    y: int
    width: int
    height: int

    @property
    def pixels(self) -> int:
        """How many are in it."""
        return self.width * self.height

    def within(self, low: tuple[float, float], high: tuple[float, float], border: int = BORDER) -> Tile:
        """The part of it that lies between two points, in pixels, and a border of so many pixels about them."""
        x0 = math.floor(max(low[0] - border, self.x))
        y0 = math.floor(max(low[1] - border, self.y))
        x1 = math.ceil(min(high[0] + border, self.x + self.width))
        y1 = math.ceil(min(high[1] + border, self.y + self.height))
        return Tile(x0, y0, x1 - x0, y1 - y0) if x0 < x1 and y0 < y1 else Tile(self.x, self.y, 0, 0)

    def grown(self, by: int, width: int, height: int) -> Tile:
        """It with so many pixels more on each side, as far as the image goes."""
        x0, y0 = max(self.x - by, 0), max(self.y - by, 0)
        x1, y1 = min(self.x + self.width + by, width), min(self.y + self.height + by, height)
        return Tile(x0, y0, x1 - x0, y1 - y0)

    def split(self, side: int) -> list[Tile]:
        """Tiles of at most side x side pixels that cover it once; none when it is empty."""
        return [
            Tile(x, y, min(side, self.x + self.width - x), min(side, self.y + self.height - y))
            for y in range(self.y, self.y + self.height, side)
            for x in range(self.x, self.x + self.width, side)
        ]


NOWHERE = Tile(0, 0, 0, 0)
