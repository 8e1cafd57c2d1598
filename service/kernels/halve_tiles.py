"""Tiles of fewer texels: each texel the mean of those of its own triangle about it."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from geometry.tile_layout import texel_at
from service.kernels.compositing import srgb_byte


@njit(cache=True, nogil=True)
def _decode(texel, colour, table, out):
    """A texel (c,) u1 as numbers that can be averaged: bytes, or premultiplied linear light and alpha."""
    if not colour:
        for k in range(3):
            out[k] = texel[k]
        return
    alpha = texel[3] / 255.0
    for k in range(3):
        out[k] = table[texel[k]] * alpha
    out[3] = alpha


@njit(cache=True, nogil=True)
def _encode(value, colour, texel):
    """The reverse, rounded."""
    if not colour:
        for k in range(3):
            texel[k] = np.uint8(min(max(value[k], 0.0), 255.0) + 0.5)
        return
    alpha = min(max(value[3], 0.0), 1.0)
    for k in range(3):
        light = min(max(value[k] / alpha, 0.0), 1.0) if alpha > 0.0 else 0.0
        texel[k] = srgb_byte(light)
    texel[3] = np.uint8(alpha * 255.0 + 0.5)


@njit(cache=True, nogil=True)
def _gather(image, face, side, columns, colour, table, tile):
    """The lattice points of a face's tile: tile (side + 1, side + 1, 4) f8, [j, i]."""
    for j in range(side + 1):
        for i in range(side + 1 - j):
            row, column = texel_at(face, i, j, side, columns)
            _decode(image[row, column], colour, table, tile[j, i])


@njit(cache=True, nogil=True)
def _mean(tile, side, x, y, reach, along, out):
    """Tent-weighted mean over the lattice points within reach of (x, y), i and j. along: 0 for all of them, 1 for those with j = 0,
    2 for those with i = 0, 3 for those on the hypotenuse.
    """
    out[:] = 0.0
    total = 0.0
    for j in range(max(0, math.ceil(y - reach)), min(side, math.floor(y + reach)) + 1):
        for i in range(max(0, math.ceil(x - reach)), min(side - j, math.floor(x + reach)) + 1):
            if (along == 1 and j != 0) or (along == 2 and i != 0) or (along == 3 and i + j != side):
                continue
            weight = 1.0 - abs(i - x) / reach
            if along == 2:
                weight = 1.0 - abs(j - y) / reach
            elif along == 0:
                weight *= 1.0 - abs(j - y) / reach
            if weight > 0.0:
                for k in range(4):
                    out[k] += weight * tile[j, i, k]
                total += weight
    for k in range(4):
        out[k] /= total


@njit(cache=True, nogil=True)
def _halve(tile, side, small_side, small):
    """Lattice points and padding of a tile of small_side: small (small_side + 2, small_side + 2, 4) f8, [j, i].

    Points on a side are means of points on that side, and corners are the corners: faces that share an edge agree along it as before.
    """
    step = side / small_side
    reach = max(step, 1.0)
    for j in range(small_side + 1):
        for i in range(small_side + 1 - j):
            x, y = i * step, j * step
            legs = (i == 0) + (j == 0) + (i + j == small_side)
            if legs >= 2:
                small[j, i] = tile[round(y), round(x)]
            elif j == 0:
                _mean(tile, side, x, 0.0, reach, 1, small[j, i])
            elif i == 0:
                _mean(tile, side, 0.0, y, reach, 2, small[j, i])
            elif i + j == small_side:
                _mean(tile, side, x, side - x, reach, 3, small[j, i])
            else:
                _mean(tile, side, x, y, reach, 0, small[j, i])
    for i in range(1, small_side + 1):
        j = small_side + 1 - i
        for k in range(4):
            small[j, i, k] = small[j - 1, i, k] + small[j, i - 1, k] - small[j - 1, i - 1, k]


@njit(cache=True, nogil=True)
def halve_tiles(image, faces, side, columns, small_side, colour, table, out):
    """Fill out (h, w, c) u1 with the tiles of image (h, w, c) u1 at small_side steps a leg instead of side, in the same cells.

    colour: whether texels are sRGB and straight alpha, averaged in linear light by table (256,) f8, and not directions.
    """
    tile, small = np.zeros((side + 1, side + 1, 4)), np.zeros((small_side + 2, small_side + 2, 4))
    for face in range(faces):
        _gather(image, face, side, columns, colour, table, tile)
        _halve(tile, side, small_side, small)
        for j in range(small_side + 2):
            for i in range(small_side + 2 - j):
                if i + j <= small_side or (i > 0 and j > 0):
                    row, column = texel_at(face, i, j, small_side, columns)
                    _encode(small[j, i], colour, out[row, column])
