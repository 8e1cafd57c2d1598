"""Where the triangle tiles of a hull's faces lie in its maps.

A tile of side K holds the lattice points (i, j), i + j <= K, of its face: texel (i, j) has the barycentric weights
(1 - (i + j) / K, i / K, j / K) of the corners turned so that the right angle comes first. Two tiles share a cell of K + 3 by
K + 2 texels, the second turned by half a turn. K = 3, tile A, tile B, padding in lower case, `.` unused:

    A A A A . b
    A A A a b B
    A A a b B B
    A a b B B B
    a . B B B B

Texel (i, j) with i + j = K + 1 is the padding that bilinear lookup on the hypotenuse reads besides the tile itself. It
continues the lattice as a parallelogram, so that along the hypotenuse the lookup is linear between the lattice points, just
as along the legs: two faces that share an edge agree along it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

INSET = 1.0 / 64.0
"""Texels by which the corners of a tile lie inside its lattice: more than the 1/256 texel that samplers round to."""


@njit(cache=True)
def texel_at(face, i, j, side, columns):
    """(row, column) of texel (i, j) of a face's tile."""
    cell = face // 2
    row, column = cell // columns * (side + 2), cell % columns * (side + 3)
    if face % 2 == 0:
        return row + j, column + i
    return row + side + 1 - j, column + side + 2 - i


@njit(cache=True)
def tile_owners(face_count, side, columns, height, width):
    """(h, w) i4: the face whose tile a texel belongs to, padding included; -1 where it belongs to none."""
    owner = np.full((height, width), -1, np.int32)
    for f in range(face_count):
        for j in range(side + 1):
            for i in range(side + 1):
                if i + j <= side + 1:
                    row, column = texel_at(f, i, j, side, columns)
                    owner[row, column] = f
    return owner


@dataclass(frozen=True)
class TileLayout:
    """How the tiles of `faces` hull faces lie in the maps; see above.

    side: lattice steps along a leg. columns: cells in a row. width, height: of the maps, texels.
    """

    faces: int
    side: int
    columns: int
    width: int
    height: int

    @classmethod
    def fitting(cls, faces: int, texels: int) -> TileLayout:
        """Largest tiles for `faces` faces in a rectangle whose longest side is at most `texels`.

        Where not even the smallest tiles fit, the rectangle is as much larger as they need.
        """
        cells, longest = (faces + 1) // 2, max(texels, least_texels(faces))
        side = next(k for k in range(longest - 3, 0, -1) if (longest // (k + 3)) * (longest // (k + 2)) >= cells)
        columns = min(longest // (side + 3), cells)
        return cls(faces, side, columns, columns * (side + 3), -(-cells // columns) * (side + 2))

    @classmethod
    def of(cls, tile_uv: np.ndarray, width: int, height: int) -> TileLayout:
        """The layout that made tile_uv (hf, 3, 2)."""
        side = round(float(np.ptp(tile_uv[0, :, 0].astype(np.float64))) * width + 3.0 * INSET)
        return cls(len(tile_uv), side, width // (side + 3), width, height)

    def tile_uv(self, turns: np.ndarray) -> np.ndarray:
        """(hf, 3, 2) f4 texture coordinates of the hull's corners; turns (hf,) i4: the corner at the right angle."""
        leg = self.side - 3.0 * INSET
        face = np.arange(self.faces)
        corner = 0.5 + INSET + leg * np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
        size = np.array([self.side + 3, self.side + 2])
        inside = np.where((face % 2 == 0)[:, None, None], corner, size - corner)
        cell = np.stack([face // 2 % self.columns, face // 2 // self.columns], axis=1) * size
        pixel = cell[:, None, :] + inside
        turned = np.empty_like(pixel)
        for k in range(3):
            turned[face, (turns + k) % 3] = pixel[:, k]
        return np.ascontiguousarray(turned / (self.width, self.height), np.float32)

    def owners(self) -> np.ndarray:
        """(height, width) i4: the face whose tile a texel belongs to, padding included; -1 where none."""
        return np.asarray(tile_owners(self.faces, self.side, self.columns, self.height, self.width))

    def halved(self, times: int) -> TileLayout:
        """The same cells with tiles whose sides are halved so often, but for rounding; at least one step long."""
        side, rows = max(1, round(self.side / 2**times)), self.height // (self.side + 2)
        return TileLayout(self.faces, side, self.columns, self.columns * (side + 3), rows * (side + 2))

    def turns(self, tile_uv: np.ndarray) -> np.ndarray:
        """(hf,) i4: the corner at the right angle, of the coordinates (hf, 3, 2) that `tile_uv` made for it."""
        face = np.arange(self.faces)
        size = np.array([self.side + 3, self.side + 2])
        cell = np.stack([face // 2 % self.columns, face // 2 // self.columns], axis=1) * size
        inside = tile_uv.astype(np.float64) * (self.width, self.height) - cell[:, None, :]
        inside = np.where((face % 2 == 0)[:, None, None], inside, size - inside)
        return np.argmin(inside.sum(axis=2), axis=1).astype(np.int32)


def least_texels(faces: int) -> int:
    """The shortest longest side of maps that has room for a tile on each of `faces` faces."""
    cells, texels = (faces + 1) // 2, 4
    while (texels // 4) * (texels // 3) < cells:
        texels += 1
    return texels
