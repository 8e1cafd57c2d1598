"""Tiles of fewer texels: each texel the mean of those of its own triangle about it."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from geometry.borrowing import borrowing
from geometry.tile_layout import texel_at


@njit(cache=True, nogil=True)
def tents(side, small_side):
    """Tents on the fine points about each coarse one, along a leg: (first fine point (n,) i8, weights (n, taps) f8, 0 where there is
    none).
    """
    step = side / small_side
    reach = max(step, 1.0)
    taps = math.floor(2.0 * reach) + 1
    first, weights = np.zeros(small_side + 1, np.int64), np.zeros((small_side + 1, taps))
    for n in range(small_side + 1):
        middle = n * step
        first[n] = max(0, math.ceil(middle - reach))
        for k in range(min(taps, side + 1 - first[n])):
            weights[n, k] = max(0.0, 1.0 - abs(first[n] + k - middle) / reach)
    return first, weights


@borrowing
def _gather(image, face, side, columns, colour, table, tile):
    """The lattice points of a face's tile as numbers that can be averaged: tile (side + 1, side + 1, 4) f8, [j, i], bytes, or
    premultiplied linear light and alpha.
    """
    row, column = texel_at(face, 0, 0, side, columns)
    way = 1 if face % 2 == 0 else -1
    for j in range(side + 1):
        y = row + way * j
        for i in range(side + 1 - j):
            x = column + way * i
            if colour:
                alpha = image[y, x, 3] / 255.0
                for k in range(3):
                    tile[j, i, k] = table[image[y, x, k]] * alpha
                tile[j, i, 3] = alpha
            else:
                for k in range(3):
                    tile[j, i, k] = image[y, x, k]


@borrowing
def _place(small, face, side, columns, colour, encoded, out):
    """The reverse, rounded, with the padding: out (h, w, 3 or 4) u1."""
    row, column = texel_at(face, 0, 0, side, columns)
    way, top = 1 if face % 2 == 0 else -1, encoded.shape[0] - 1
    for j in range(side + 2):
        y = row + way * j
        for i in range(side + 2 - j):
            if i + j > side and (i == 0 or j == 0):
                continue
            x = column + way * i
            if colour:
                alpha = min(max(small[j, i, 3], 0.0), 1.0)
                for k in range(3):
                    light = min(max(small[j, i, k] / alpha, 0.0), 1.0) if alpha > 0.0 else 0.0
                    out[y, x, k] = encoded[int(light * top + 0.5)]
                out[y, x, 3] = np.uint8(alpha * 255.0 + 0.5)
            else:
                for k in range(3):
                    out[y, x, k] = np.uint8(min(max(small[j, i, k], 0.0), 255.0) + 0.5)


@borrowing
def _mean_inside(tile, side, first, weights, i, j, small):
    """small[j, i]: mean over the points of the triangle about it, weighted by the product of the tents."""
    x, y, taps = first[i], first[j], weights.shape[1]
    a, b, c, d, total = 0.0, 0.0, 0.0, 0.0, 0.0
    for m in range(min(taps, side + 1 - y)):
        row, up = y + m, weights[j, m]
        for n in range(min(taps, side + 1 - row - x)):
            weight = up * weights[i, n]
            total += weight
            a += weight * tile[row, x + n, 0]
            b += weight * tile[row, x + n, 1]
            c += weight * tile[row, x + n, 2]
            d += weight * tile[row, x + n, 3]
    part = 1.0 / total
    small[j, i, 0], small[j, i, 1], small[j, i, 2], small[j, i, 3] = a * part, b * part, c * part, d * part


@borrowing
def _halve_side(tile, x, y, across, up, first, weights, n, small, i, j):
    """small[j, i]: mean over the points [y + up m, x + across m] of a side, weighted by the tent about its n-th coarse point."""
    total = 0.0
    for k in range(4):
        small[j, i, k] = 0.0
    for m in range(weights.shape[1]):
        weight, at = weights[n, m], first[n] + m
        if weight > 0.0:
            total += weight
            for k in range(4):
                small[j, i, k] += weight * tile[y + up * at, x + across * at, k]
    for k in range(4):
        small[j, i, k] /= total


@borrowing
def _halve(tile, side, small_side, first, weights, small):
    """Lattice points and padding of a tile of small_side: small (small_side + 2, small_side + 2, 4) f8, [j, i].

    Points on a side are means of points on that side, and corners are the corners: faces that share an edge agree along it as before.
    """
    last = small_side
    for k in range(4):
        small[0, 0, k], small[0, last, k], small[last, 0, k] = tile[0, 0, k], tile[0, side, k], tile[side, 0, k]
    for n in range(1, last):
        _halve_side(tile, 0, 0, 1, 0, first, weights, n, small, n, 0)
        _halve_side(tile, 0, 0, 0, 1, first, weights, n, small, 0, n)
        _halve_side(tile, 0, side, 1, -1, first, weights, n, small, n, last - n)
    for j in range(1, last):
        for i in range(1, last - j):
            _mean_inside(tile, side, first, weights, i, j, small)
    for i in range(1, last + 1):
        j = last + 1 - i
        for k in range(4):
            small[j, i, k] = small[j - 1, i, k] + small[j, i - 1, k] - small[j - 1, i - 1, k]


@njit(cache=True, nogil=True)
def halve_tiles(image, faces, side, columns, small_side, taps, light, scratch, out):
    """Fill out (h, w, c) u1 with the tiles of image (h, w, c) u1 at small_side steps a leg instead of side, in the same cells.

    taps: `tents` of the two sides. light: (whether texels are sRGB and straight alpha, averaged in linear light, and not directions;
    linear (256,) f8: of each byte; encoded (n,) u1: the byte of each amount from 0 to 1).
    scratch: ((side + 1, side + 1, 4), (small_side + 2, small_side + 2, 4)) f8.
    """
    first, weights = taps
    colour, linear, encoded = light
    tile, small = scratch
    for face in range(faces):
        _gather(image, face, side, columns, colour, linear, tile)
        _halve(tile, side, small_side, first, weights, small)
        _place(small, face, small_side, columns, colour, encoded, out)
