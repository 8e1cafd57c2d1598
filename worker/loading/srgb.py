"""Arithmetic of colours in linear light: products and means of sRGB bytes with straight alpha (IEC 61966-2-1)."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from schemas.conventions import F4, F8, U1

BAND_PIXELS = 1 << 22
"""Source pixels of a picture that are held in linear light at a time: 64 MiB."""


def _decoded_bytes() -> F4:
    c = np.arange(256) / 255.0
    return np.where(c <= 0.04045, c / 12.92, ((c + 0.055) / 1.055) ** 2.4).astype(np.float32)


LINEAR = _decoded_bytes()
"""(256,) f4: linear light of each byte."""


def encoded(linear: F4 | F8) -> U1:
    """Bytes of linear light 0..1, an array of any shape."""
    c: F8 = np.clip(linear, 0.0, 1.0).astype(np.float64)
    return np.rint(np.where(c <= 0.0031308, 12.92 * c, 1.055 * np.power(c, 1.0 / 2.4) - 0.055) * 255.0).astype(np.uint8)


def multiplied(color: U1, tint: U1) -> U1:
    """(..., 4) u1: the light of one colour after that of the other; alphas are multiplied too."""
    alpha = (color[..., 3:].astype(np.uint16) * tint[..., 3:] + 127) // 255
    return np.concatenate([encoded(LINEAR[color[..., :3]] * LINEAR[tint[..., :3]]), alpha.astype(np.uint8)], axis=-1)


def resized(picture: Any, width: int, height: int) -> U1:
    """(height, width, 4) u1: an RGBA picture of PIL, smaller; each texel is the mean of those it replaces, weighted by alpha."""
    from PIL import Image

    step = picture.height / height
    rows = max(1, int(BAND_PIXELS / (picture.width * math.ceil(step))))
    out = np.empty((height, width, 4), np.uint8)
    for first in range(0, height, rows):
        last = min(first + rows, height)
        top, bottom = math.floor(first * step), min(math.ceil(last * step), picture.height)
        band = np.asarray(picture.crop((0, top, picture.width, bottom)), np.uint8)
        alpha = band[..., 3].astype(np.float32) / 255.0
        layers = [*(LINEAR[band[..., k]] * alpha for k in range(3)), alpha]
        box = (0.0, first * step - top, float(picture.width), min(last * step, picture.height) - top)
        means = [np.asarray(Image.fromarray(a).resize((width, last - first), Image.Resampling.BOX, box=box)) for a in layers]
        whole = np.maximum(means[3], 1e-6)
        for k in range(3):
            out[first:last, :, k] = encoded(means[k] / whole)
        out[first:last, :, 3] = np.rint(np.clip(means[3], 0.0, 1.0) * 255.0)
    return out
