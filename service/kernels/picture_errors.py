"""Pictures against a reference with many samples a pixel: sums over pixels."""

from __future__ import annotations

import numpy as np
from numba import njit

FULL = 255


@njit(cache=True, nogil=True)
def reduce_samples(pixels, side, table, out):
    """Mean of side x side samples: pixels (h * side, w * side) u4 words of sRGB and alpha, to out (h, w, 4) f4, premultiplied linear.

    table: (256,) f4 linear light of sRGB bytes. Alpha of the samples is the weight of their colour; the mean of samples that are opaque
    or empty has their exact share as its alpha, for up to 256 of them.
    """
    whole = np.float32(255 * side * side)
    for y in range(out.shape[0]):
        for x in range(out.shape[1]):
            r = g = b = a = np.float32(0.0)
            for j in range(side):
                row = pixels[y * side + j]
                for i in range(side):
                    word = row[x * side + i]
                    alpha = np.float32(word >> np.uint32(24))
                    if alpha > 0.0:
                        r += alpha * table[word & np.uint32(FULL)]
                        g += alpha * table[(word >> np.uint32(8)) & np.uint32(FULL)]
                        b += alpha * table[(word >> np.uint32(16)) & np.uint32(FULL)]
                        a += alpha
            out[y, x, 0], out[y, x, 1], out[y, x, 2], out[y, x, 3] = r / whole, g / whole, b / whole, a / whole


@njit(cache=True, nogil=True)
def outline_sums(made, true):
    """(sum of |d|, sum of d d, boundary pixels, wrong pixels, largest |d|), where d is made (h, w) u1 alpha less true (h, w) f4.

    Boundary pixels are those with 0 < true < 1, and the first two sums are over them; wrong are pixels off by more than one half; the
    largest is over all pixels.
    """
    total = squares = largest = 0.0
    boundary = wrong = 0
    for y in range(made.shape[0]):
        for x in range(made.shape[1]):
            t = np.float64(true[y, x])
            d = abs(made[y, x] / 255.0 - t)
            if 0.0 < t < 1.0:
                total += d
                squares += d * d
                boundary += 1
            if d > 0.5:
                wrong += 1
            largest = max(largest, d)
    return total, squares, boundary, wrong, largest


@njit(cache=True, nogil=True)
def far_pixels(made, true, out):
    """Mark pixels that show the mesh where there is nothing of it, or nothing where there is only it: out (h, w) bool; how many."""
    count = 0
    for y in range(made.shape[0]):
        for x in range(made.shape[1]):
            out[y, x] = (true[y, x] == 0.0 and made[y, x] > 127) or (true[y, x] == 1.0 and made[y, x] < 128)
            count += out[y, x]
    return count


@njit(cache=True, nogil=True)
def colour_sums(made, true, encode, luma, mask):
    """(sum of squared errors of sRGB bytes, how many bytes), over pixels that both cover fully.

    made (h, w, 4) u1 straight sRGB; true (h, w, 4) f4 premultiplied linear; encode (n,) f4: sRGB in 0..255 of evenly spaced linear light.
    Writes luma (2, h, w) f4 of both, 0..255, and mask (h, w) f4: 1 for those pixels; both 0 for the others.
    """
    error, count, last = 0.0, 0, encode.shape[0] - 1
    for y in range(made.shape[0]):
        for x in range(made.shape[1]):
            mask[y, x] = luma[0, y, x] = luma[1, y, x] = np.float32(0.0)
            if true[y, x, 3] < 1.0 or made[y, x, 3] != FULL:
                continue
            mask[y, x] = np.float32(1.0)
            for c in range(3):
                at = min(max(true[y, x, c], np.float32(0.0)), np.float32(1.0)) * np.float32(last)
                low = min(int(at), last - 1)
                byte = encode[low] + (encode[low + 1] - encode[low]) * (at - np.float32(low))
                weight = np.float32(0.2126) if c == 0 else np.float32(0.7152) if c == 1 else np.float32(0.0722)
                luma[0, y, x] += weight * np.float32(made[y, x, c])
                luma[1, y, x] += weight * byte
                d = np.float64(made[y, x, c]) - np.float64(byte)
                error += d * d
                count += 1
    return error, count
