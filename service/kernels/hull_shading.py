"""Colours of the pixels of which `hull_visible` says what they show, laid over the background with the alpha of a mask.

A row at a time, in steps that are loops without branches: where in the map each pixel lies (runs of pixels of one face), the
normal there (bilinear), the light that falls on it, and its colour from a table.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from geometry.borrowing import borrowing
from service.kernels.compositing import BYTE, COLOR, SHIFT, ZERO, blended
from service.kernels.hull_visible import FACE_MASK, SLACK

LEVELS = 4096  # steps of light that colours are tabulated for: 0.4 of 255 levels at the darkest, where sRGB is steepest
LOOKED_AT = 16  # pixels at a time
FLAT, TINTED, NORMALS = 0, 1, 2  # what is shown: one colour, that of the map, or normals as colours
TOP = np.float32(LEVELS - 1)
MIDDLE = np.float32(127.5)
ONE, HALF, TINY = np.float32(1.0), np.float32(0.5), np.float32(1e-20)
TO_UNIT = np.float32(2.0 / 255.0)
B0, B1, B2 = np.uint32(0), np.uint32(8), np.uint32(16)


@borrowing
def place_row(words, planes, x0, y, u, v):
    """Texel coordinates u, v (n,) f4 of the pixels of a row whose centres are at x0 + 1/2 and so on, y."""
    start, n = 0, words.shape[0]
    while start < n:
        face = words[start] & FACE_MASK
        end = start + 1
        while end < n and words[end] & FACE_MASK == face:
            end += 1
        if face == FACE_MASK:
            u[start:end], v[start:end] = np.float32(0.0), np.float32(0.0)
        else:
            p = planes[face]
            x = x0 + start + 0.5
            fu, du = np.float32(p[0] * x + p[1] * y + p[2]), np.float32(p[0])
            fv, dv = np.float32(p[3] * x + p[4] * y + p[5]), np.float32(p[3])
            fw, dw = np.float32(p[6] * x + p[7] * y + p[8]), np.float32(p[6])
            for i in range(np.uint64(end - start)):
                t = np.float32(np.int32(i))
                w = ONE / (fw + t * dw)
                u[np.uint64(start) + i] = (fu + t * du) * w
                v[np.uint64(start) + i] = (fv + t * dv) * w
        start = end


@borrowing
def _find(n, u, v, width, height, at):
    """Split texel coordinates into the number of the texel and, in their place, how far the pixel is from it."""
    far_u, far_v, stride = np.float32(width) - np.float32(1.001), np.float32(height) - np.float32(1.001), np.int32(width)
    for i in range(n):
        x = min(max(u[i] - HALF, np.float32(0.0)), far_u)
        y = min(max(v[i] - HALF, np.float32(0.0)), far_v)
        column, row = np.int32(x), np.int32(y)
        at[i] = np.int32(row * stride + column)
        u[i] = x - np.float32(column)
        v[i] = y - np.float32(row)


@borrowing
def _fetch(n, at, texels, stride, near):
    """near (4, n) u4: the texels about each pixel."""
    a, b, c, d = near[0], near[1], near[2], near[3]
    for i in range(n):
        k = np.uint64(at[i])
        a[i] = texels[k]
        b[i] = texels[k + np.uint64(1)]
        c[i] = texels[k + stride]
        d[i] = texels[k + stride + np.uint64(1)]


@borrowing
def _byte(word, shift):
    return np.float32(np.int32((word >> shift) & BYTE))


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "nsz"})
def _light(n, s, t, near, turn, light, ambient, lit):
    lx, ly, lz = light[0], light[1], light[2]
    xx, xy, xz, yx, yy, yz = turn[0, 0], turn[0, 1], turn[0, 2], turn[1, 0], turn[1, 1], turn[1, 2]
    zx, zy, zz = turn[2, 0], turn[2, 1], turn[2, 2]
    part = ONE - ambient
    na, nb, nc, nd = near[0], near[1], near[2], near[3]
    for i in range(n):
        a, b, c, d = na[i], nb[i], nc[i], nd[i]
        wd = s[i] * t[i]
        wb, wc = s[i] - wd, t[i] - wd
        wa = ONE - s[i] - wc
        x = _byte(a, B0) * wa + _byte(b, B0) * wb + _byte(c, B0) * wc + _byte(d, B0) * wd
        y = _byte(a, B1) * wa + _byte(b, B1) * wb + _byte(c, B1) * wc + _byte(d, B1) * wd
        z = _byte(a, B2) * wa + _byte(b, B2) * wb + _byte(c, B2) * wc + _byte(d, B2) * wd
        x, y, z = x * TO_UNIT - ONE, y * TO_UNIT - ONE, z * TO_UNIT - ONE
        x, y, z = xx * x + xy * y + xz * z, yx * x + yy * y + yz * z, zx * x + zy * y + zz * z
        facing = (x * lx + y * ly + z * lz) / np.float32(math.sqrt(max(x * x + y * y + z * z, TINY)))
        lit[i] = max(facing, np.float32(0.0)) * part + ambient


@borrowing
def _pick(n, lit, palette, colors):
    for i in range(n):
        colors[i] = palette[np.uint64(np.int32(lit[i] * TOP + HALF))]


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "nsz"})
def _tint(n, s, t, near, lit, linear, encoded, colors):
    """Colours (n,) u4 of the map, decoded, filtered, lit and encoded again."""
    for i in range(n):
        wd = s[i] * t[i]
        wb, wc = s[i] - wd, t[i] - wd
        wa = ONE - s[i] - wc
        word = ZERO
        for k in range(3):
            shift = np.uint32(8 * k)
            c = linear[(near[0, i] >> shift) & BYTE] * wa + linear[(near[1, i] >> shift) & BYTE] * wb
            c += linear[(near[2, i] >> shift) & BYTE] * wc + linear[(near[3, i] >> shift) & BYTE] * wd
            word |= np.uint32(encoded[np.uint64(np.int32(c * lit[i] * TOP + HALF))]) << shift
        colors[i] = word


@borrowing
def _show(n, s, t, near, turn, colors):
    """Normals (n,) u4 as colours."""
    xx, xy, xz, yx, yy, yz = turn[0, 0], turn[0, 1], turn[0, 2], turn[1, 0], turn[1, 1], turn[1, 2]
    zx, zy, zz = turn[2, 0], turn[2, 1], turn[2, 2]
    for i in range(n):
        wd = s[i] * t[i]
        wb, wc = s[i] - wd, t[i] - wd
        wa = ONE - s[i] - wc
        a, b, c, d = near[0, i], near[1, i], near[2, i], near[3, i]
        x = (_byte(a, B0) * wa + _byte(b, B0) * wb + _byte(c, B0) * wc + _byte(d, B0) * wd) * TO_UNIT - ONE
        y = (_byte(a, B1) * wa + _byte(b, B1) * wb + _byte(c, B1) * wc + _byte(d, B1) * wd) * TO_UNIT - ONE
        z = (_byte(a, B2) * wa + _byte(b, B2) * wb + _byte(c, B2) * wc + _byte(d, B2) * wd) * TO_UNIT - ONE
        x, y, z = xx * x + xy * y + xz * z, yx * x + yy * y + yz * z, zx * x + zy * y + zz * z
        half = MIDDLE / np.float32(math.sqrt(max(x * x + y * y + z * z, TINY)))
        word = np.uint32(np.int32(x * half + MIDDLE + HALF)) | (np.uint32(np.int32(y * half + MIDDLE + HALF)) << B1)
        colors[i] = word | (np.uint32(np.int32(z * half + MIDDLE + HALF)) << B2)


@borrowing
def _lay(n, colors, mask, out, opaque, linear):
    """Colours with the mask's alpha over what is in a row of the image."""
    if opaque:
        for i in range(n):
            out[i] = blended((colors[i] & COLOR) | (BYTE << SHIFT), np.uint32(mask[i]), out[i], linear)
    else:
        for i in range(n):
            alpha = np.uint32(mask[i])
            out[i] = (colors[i] | (alpha << SHIFT)) if alpha != ZERO else ZERO


@borrowing
def _is_empty(mask, start):
    found = np.uint8(0)
    for k in range(np.uint64(LOOKED_AT)):
        found |= mask[np.uint64(start) + k]
    return found == 0


@borrowing
def _span(mask, x0, x1):
    """The columns of a row from the first that is not empty to behind the last."""
    while x0 + LOOKED_AT <= x1 and _is_empty(mask, x0):
        x0 += LOOKED_AT
    while x0 < x1 and mask[x0] == 0:
        x0 += 1
    while x0 + LOOKED_AT <= x1 and _is_empty(mask, x1 - LOOKED_AT):
        x1 -= LOOKED_AT
    while x0 < x1 and mask[x1 - 1] == 0:
        x1 -= 1
    return x0, x1


@njit(cache=True, nogil=True, error_model="numpy")
def paint(words, planes, x0, y0, mask, out, maps, shading, ground, scratch):
    """Paint a rectangle of the image out (h, w) u4 that begins at (x0, y0) and is as large as words, with the alpha mask (h, w) u1.

    words, planes: of `hull_visible` and `hull_rim`. maps: (normals, colours, width, height), both (width * height + 1,) u4 texels.
    shading: (FLAT, TINTED or NORMALS; turn (3, 3) f4, what is done to normals; light (3,) f4 unit, along the axes they have then; ambient
    f4; palette (LEVELS,) u4: the colour of each amount of light, for FLAT; encoded (LEVELS,) u1: sRGB of each amount of linear light).
    ground: (whether out holds an opaque background, which otherwise is overwritten; linear (256,) f4: of each sRGB byte).
    scratch: (floats (3, n) f4, texels (4, n) u4, places (n,) i4, colors (n,) u4), n at least the columns of words.
    """
    normals, tints, width, height = maps
    shown, turn, light, ambient, palette, encoded = shading
    opaque, linear = ground
    floats, near, at, colors = scratch
    columns = words.shape[1] - SLACK
    u, v, lit, stride = floats[0], floats[1], floats[2], np.uint64(width)
    for row in range(words.shape[0]):
        first, last = _span(mask[y0 + row], x0, x0 + columns)
        if not opaque:
            out[y0 + row, x0:first] = ZERO
            out[y0 + row, last : x0 + columns] = ZERO
        n = last - first
        if n <= 0:
            continue
        place_row(words[row, first - x0 : last - x0], planes, first, y0 + row + 0.5, u, v)
        _find(n, u, v, width, height, at)
        _fetch(n, at, normals, stride, near)
        if shown == NORMALS:
            _show(n, u, v, near, turn, colors)
        else:
            _light(n, u, v, near, turn, light, ambient, lit)
            if shown == TINTED:
                _fetch(n, at, tints, stride, near)
                _tint(n, u, v, near, lit, linear, encoded, colors)
            else:
                _pick(n, lit, palette, colors)
        _lay(n, colors, mask[y0 + row, first:last], out[y0 + row, first:last], opaque, linear)
