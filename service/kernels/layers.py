"""Layers over one another, each pixel rounded to bytes once however many layers meet in it.

Words are as in `compositing`. A pixel is *whole* while its word alone says what is there: the background, or an opaque layer. Where
a layer covers it in part, it becomes mixed: its premultiplied linear light is kept in float32 until the end.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from service.kernels.compositing import srgb_byte

BYTE = np.uint32(0xFF)
SHIFT = np.uint32(24)
ZERO = np.uint32(0)
ONE = np.float32(1.0)


@njit(cache=True, nogil=True)
def put_over(layer, x0, y0, x1, y1, image, mixed, light, table):
    """Lay layer (h, w) u4, of which columns x0..x1 and rows y0..y1 count, over image (h, w) u4.

    mixed (h, w) u1 says where light (h, w, 4) f4 is meant. table: `linear_table()`.
    """
    for i in range(y0, y1):
        for j in range(x0, x1):
            word = layer[i, j]
            alpha = word >> SHIFT
            if alpha == ZERO:
                continue
            if alpha == BYTE:
                image[i, j] = word
                mixed[i, j] = 0
                continue
            a = np.float32(alpha) / np.float32(255.0)
            if mixed[i, j] == 0:
                ground = image[i, j]
                b = np.float32(ground >> SHIFT) / np.float32(255.0)
                for k in range(3):
                    light[i, j, k] = table[(ground >> np.uint32(8 * k)) & BYTE] * b
                light[i, j, 3] = b
                mixed[i, j] = 1
            for k in range(3):
                light[i, j, k] = table[(word >> np.uint32(8 * k)) & BYTE] * a + light[i, j, k] * (ONE - a)
            if light[i, j, 3] < ONE:  # what is opaque stays so to the last bit
                light[i, j, 3] = a + light[i, j, 3] * (ONE - a)


@njit(cache=True, nogil=True)
def settle(image, mixed, light):
    """Turn the mixed pixels of the image back into words: sRGB bytes, straight alpha."""
    for i in range(image.shape[0]):
        for j in range(image.shape[1]):
            if mixed[i, j] == 0:
                continue
            alpha = light[i, j, 3]
            word = np.uint32(alpha * np.float32(255.0) + np.float32(0.5)) << SHIFT
            for k in range(3):
                word |= srgb_byte(min(light[i, j, k] / alpha, ONE)) << np.uint32(8 * k)
            image[i, j] = word
