"""The colour of a surface point: interpolated corner colours times a bilinear texture, in linear light."""

from __future__ import annotations

import math

import numpy as np
from numba import njit


def linear_table():
    """(256,) f8: linear light of each sRGB byte (IEC 61966-2-1)."""
    c = np.arange(256) / 255.0
    return np.where(c <= 0.04045, c / 12.92, ((c + 0.055) / 1.055) ** 2.4)


@njit(cache=True)
def _accumulate(total, table, red, green, blue, alpha, weight):
    """total (4,) += weight times the colour in linear light, premultiplied."""
    a = weight * alpha / 255.0
    total[0] += a * table[red]
    total[1] += a * table[green]
    total[2] += a * table[blue]
    total[3] += a


@njit(cache=True)
def _straight(total):
    """Undo the premultiplication of total (4,) in place."""
    if total[3] > 0.0:
        for k in range(3):
            total[k] /= total[3]


@njit(cache=True)
def corner_colors(corner_color, found, weights, table):
    """(n, 4) f8 linear, straight alpha. corner_color (f, 3, 4) u1 sRGB; found (n,) i4 faces; weights (n, 3) f8; table (256,) f8."""
    out = np.zeros((found.shape[0], 4))
    for n in range(found.shape[0]):
        for i in range(3):
            c = corner_color[found[n], i]
            _accumulate(out[n], table, c[0], c[1], c[2], c[3], weights[n, i])
        _straight(out[n])
    return out


@njit(cache=True)
def texture_colors(corner_uv, texture, found, weights, table):
    """(n, 4) f8 linear, straight alpha: bilinear, repeated in both directions. corner_uv (f, 3, 2) f4, v upwards; texture (h, w, 4) u1."""
    height, width = texture.shape[0], texture.shape[1]
    out = np.zeros((found.shape[0], 4))
    for n in range(found.shape[0]):
        u = v = 0.0
        for i in range(3):
            u += weights[n, i] * corner_uv[found[n], i, 0]
            v += weights[n, i] * corner_uv[found[n], i, 1]
        x = (u - math.floor(u)) * width - 0.5
        y = (1.0 - (v - math.floor(v))) * height - 0.5
        column, row = math.floor(x), math.floor(y)
        for j in range(2):
            for i in range(2):
                c = texture[(row + j) % height, (column + i) % width]
                weight = (abs(1 - i - (x - column))) * (abs(1 - j - (y - row)))
                _accumulate(out[n], table, c[0], c[1], c[2], c[3], weight)
        _straight(out[n])
    return out
