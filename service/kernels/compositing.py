"""Drawn pixels, an alpha and a background into one image.

Pixels are little-endian words, one a pixel: red in the lowest byte, alpha in the highest; sRGB, straight alpha. Each kernel has
a loop for a transparent background, without a branch so that it is vectorised, and one for an opaque background that
blends, in linear light, only where alpha is neither nothing nor full.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

COLOR = np.uint32(0x00FFFFFF)
SHIFT = np.uint32(24)
BYTE = np.uint32(0xFF)
ZERO = np.uint32(0)


def linear_table():
    """(256,) f4: linear light of each sRGB byte (IEC 61966-2-1)."""
    c = np.arange(256) / 255.0
    return np.where(c <= 0.04045, c / 12.92, ((c + 0.055) / 1.055) ** 2.4).astype(np.float32)


def srgb_of(linear):
    """sRGB bytes, u1, of linear light 0..1, an array of any shape (IEC 61966-2-1)."""
    c = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1.0 / 2.4) - 0.055)
    return np.floor(255.0 * c + 0.5).astype(np.uint8)


@njit(cache=True, nogil=True)
def srgb_byte(c):
    """The sRGB byte of linear light 0..1."""
    s = 12.92 * c if c <= 0.0031308 else 1.055 * math.pow(c, 1.0 / 2.4) - 0.055
    return np.uint32(s * 255.0 + 0.5)


@njit(cache=True, nogil=True)
def _blend(front, alpha, ground, table):
    """Colour word over an opaque ground word; alpha 0..255."""
    a = np.float32(alpha) / np.float32(255.0)
    out = np.uint32(0xFF000000)
    for k in range(3):
        shift = np.uint32(8 * k)
        f, g = table[(front >> shift) & BYTE], table[(ground >> shift) & BYTE]
        out |= srgb_byte(f * a + g * (np.float32(1.0) - a)) << shift
    return out


@njit(cache=True, nogil=True)
def blended(front, alpha, ground, table):
    """The same, without the work where alpha is nothing or full."""
    if alpha == BYTE:
        return front
    return _blend(front, alpha, ground, table) if alpha != ZERO else ground


@njit(cache=True, nogil=True)
def put_drawn(drawn, out, opaque, table):
    """Lay drawn (h, w) u4 with its own alpha over out (h, w) u4, which holds nothing, or an opaque background."""
    for i in range(out.shape[0]):
        if not opaque:
            out[i] = drawn[i]
            continue
        for j in range(out.shape[1]):
            out[i, j] = blended(drawn[i, j], drawn[i, j] >> SHIFT, out[i, j], table)


@njit(cache=True, nogil=True)
def put_masked(drawn, mask, out, opaque, table):
    """The same with the alpha of a mask (h, w) u1; drawn must have a colour wherever the mask is not zero."""
    for i in range(out.shape[0]):
        if opaque:
            for j in range(out.shape[1]):
                alpha = np.uint32(mask[i, j])
                out[i, j] = blended((drawn[i, j] & COLOR) | (BYTE << SHIFT), alpha, out[i, j], table)
        else:
            for j in range(out.shape[1]):
                alpha = np.uint32(mask[i, j])
                word = (drawn[i, j] & COLOR) | (alpha << SHIFT)
                out[i, j] = word if alpha != ZERO else ZERO


@njit(cache=True, nogil=True)
def put_flat(color, mask, out, opaque, table):
    """The same with one colour word everywhere."""
    for i in range(out.shape[0]):
        for j in range(out.shape[1]):
            alpha = np.uint32(mask[i, j])
            if opaque:
                out[i, j] = blended((color & COLOR) | (BYTE << SHIFT), alpha, out[i, j], table)
            else:
                word = (color & COLOR) | (alpha << SHIFT)
                out[i, j] = word if alpha != ZERO else ZERO
