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
def _overlaps(size, smaller, k):
    """(first, last, begin, end): the texels that texel k of a line of `smaller` stands for of one of `size`, and where it ends in them."""
    begin, end = k * size / smaller, (k + 1) * size / smaller
    return math.floor(begin), min(math.ceil(end), size), begin, end


@njit(cache=True)
def halved(texture, table):
    """(max(h // 2, 1), max(w // 2, 1), 4) u1: means of texture (h, w, 4) u1 in linear light, weighted by alpha."""
    height, width = texture.shape[0], texture.shape[1]
    out = np.empty((max(height // 2, 1), max(width // 2, 1), 4), np.uint8)
    total = np.empty(8)
    for j in range(out.shape[0]):
        top, bottom, low, high = _overlaps(height, out.shape[0], j)
        for i in range(out.shape[1]):
            left, right, first, last = _overlaps(width, out.shape[1], i)
            total[:] = 0.0
            for row in range(top, bottom):
                down = min(high, row + 1.0) - max(low, float(row))
                for column in range(left, right):
                    c = texture[row, column]
                    weight = down * (min(last, column + 1.0) - max(first, float(column)))
                    _accumulate(total, table, c[0], c[1], c[2], c[3], weight)
            area = (high - low) * (last - first)
            _straight(total)
            for k in range(3):
                out[j, i, k] = _srgb_byte(total[k])
            out[j, i, 3] = np.uint8(min(total[3] / area, 1.0) * 255.0 + 0.5)
    return out


@njit(cache=True)
def _srgb_byte(c):
    c = min(max(c, 0.0), 1.0)
    s = 12.92 * c if c <= 0.0031308 else 1.055 * math.pow(c, 1.0 / 2.4) - 0.055
    return np.uint8(s * 255.0 + 0.5)


@njit(cache=True)
def _accumulate(total, table, red, green, blue, alpha, weight):
    """total (8,) += weight times the colour in linear light: premultiplied, and after that without regard to alpha."""
    a = weight * alpha / 255.0
    total[0] += a * table[red]
    total[1] += a * table[green]
    total[2] += a * table[blue]
    total[3] += a
    total[4] += weight * table[red]
    total[5] += weight * table[green]
    total[6] += weight * table[blue]
    total[7] += weight


@njit(cache=True)
def _straight(total):
    """Undo the premultiplication of total (8,) in place; where nothing is opaque the colours count alike, as pictures are opaque."""
    for k in range(3):
        if total[3] > 0.0:
            total[k] /= total[3]
        elif total[7] > 0.0:
            total[k] = total[4 + k] / total[7]


@njit(cache=True)
def corner_colors(corner_color, found, weights, table):
    """(n, 4) f8 linear, straight alpha. corner_color (f, 3, 4) u1 sRGB; found (n,) i4 faces; weights (n, 3) f8; table (256,) f8."""
    out = np.empty((found.shape[0], 4))
    total = np.empty(8)
    for n in range(found.shape[0]):
        total[:] = 0.0
        for i in range(3):
            c = corner_color[found[n], i]
            _accumulate(total, table, c[0], c[1], c[2], c[3], weights[n, i])
        _straight(total)
        out[n] = total[:4]
    return out


@njit(cache=True)
def texel_densities(corner_uv, positions, faces, width, height):
    """(f,) f8: texels of a width x height texture on a unit of area of each face; corner_uv (f, 3, 2) f4; 0 for faces without area."""
    out = np.zeros(faces.shape[0])
    e, d = np.empty(3), np.empty(3)
    for f in range(faces.shape[0]):
        for k in range(3):
            a = np.float64(positions[faces[f, 0], k])
            e[k], d[k] = positions[faces[f, 1], k] - a, positions[faces[f, 2], k] - a
        x, y, z = e[1] * d[2] - e[2] * d[1], e[2] * d[0] - e[0] * d[2], e[0] * d[1] - e[1] * d[0]
        area = math.sqrt(x * x + y * y + z * z)
        uv = corner_uv[f]
        s, t = np.float64(uv[1, 0]) - uv[0, 0], np.float64(uv[1, 1]) - uv[0, 1]
        u, v = np.float64(uv[2, 0]) - uv[0, 0], np.float64(uv[2, 1]) - uv[0, 1]
        if area > 0.0:
            out[f] = abs(s * v - t * u) * width * height / area
    return out


@njit(cache=True)
def _add_bilinear(total, texels, start, width, height, u, v, part, table):
    """Add `part` of the bilinear colour at (u, v) of a level that begins at texels[start]; repeated in both directions."""
    x = (u - math.floor(u)) * width - 0.5
    y = (1.0 - (v - math.floor(v))) * height - 0.5
    column, row = math.floor(x), math.floor(y)
    for j in range(2):
        for i in range(2):
            c = texels[start + (row + j) % height * width + (column + i) % width]
            weight = abs(1 - i - (x - column)) * abs(1 - j - (y - row))
            _accumulate(total, table, c[0], c[1], c[2], c[3], part * weight)


@njit(cache=True)
def texture_colors(corner_uv, texels, levels, found, weights, footprints, table):
    """(n, 4) f8 linear, straight alpha: trilinear. corner_uv (f, 3, 2) f4, v upwards.

    texels (t, 4) u1 sRGB of all levels, levels (l, 3) i8: where each begins, its width and height; each has half the sides of the one
    before (`halved`). footprints (n,) f8: texels of level 0 that a sample stands for; a fourth of them at each level.
    """
    out = np.empty((found.shape[0], 4))
    total = np.empty(8)
    last = levels.shape[0] - 1
    for n in range(found.shape[0]):
        u = v = 0.0
        for i in range(3):
            u += weights[n, i] * corner_uv[found[n], i, 0]
            v += weights[n, i] * corner_uv[found[n], i, 1]
        deep = min(0.5 * math.log2(footprints[n]), float(last)) if footprints[n] > 1.0 else 0.0
        level = int(deep)
        total[:] = 0.0
        _add_bilinear(total, texels, levels[level, 0], levels[level, 1], levels[level, 2], u, v, 1.0 - (deep - level), table)
        if deep > level:
            k = level + 1
            _add_bilinear(total, texels, levels[k, 0], levels[k, 1], levels[k, 2], u, v, deep - level, table)
        _straight(total)
        out[n] = total[:4]
    return out
