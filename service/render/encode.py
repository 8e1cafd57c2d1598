"""Images as bytes: PNG by a small writer of our own for live answers, everything else by Pillow."""

from __future__ import annotations

import struct
import zlib
from io import BytesIO

import numpy as np
from isal import isal_zlib
from PIL import Image

from backend.tracing import span
from schemas.conventions import U1
from schemas.render import ImageFormat
from service.kernels import compositing

WEBP_QUALITY = 90
JPEG_QUALITY = 92
DEFLATE_LEVEL = 1  # isal's second of four
PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_RGBA8 = bytes([8, 6, 0, 0, 0])  # bits a channel, RGBA, deflate, adaptive filters, no interlace
_SUB = 1


def encode(pixels: U1, image_format: ImageFormat) -> bytes:
    """Encode (h, w, 4) u1 sRGB pixels with straight alpha, row 0 at the top. JPEG, which has no alpha, lies on white."""
    with span("encode", format=image_format.value):
        return _encoded(pixels, image_format)


def _encoded(pixels: U1, image_format: ImageFormat) -> bytes:
    if image_format is ImageFormat.PNG:
        return _png(pixels)
    if image_format is ImageFormat.RAW:
        return np.ascontiguousarray(pixels).tobytes()
    out = BytesIO()
    if image_format is ImageFormat.WEBP:
        Image.fromarray(pixels).save(out, "WEBP", quality=WEBP_QUALITY, method=0)
    else:
        Image.fromarray(_on_white(pixels)).convert("RGB").save(out, "JPEG", quality=JPEG_QUALITY)
    return out.getvalue()


def _on_white(pixels: U1) -> U1:
    paper = np.full(pixels.shape, 255, np.uint8)
    drawn = np.ascontiguousarray(pixels).view("<u4")[:, :, 0]
    compositing.put_drawn(drawn, paper.view("<u4")[:, :, 0], True, compositing.linear_table())
    return paper


def _png(pixels: U1) -> bytes:
    """PNG (ISO/IEC 15948) with the Sub filter on every row."""
    height, width = pixels.shape[:2]
    rows = np.empty((height, 1 + 4 * width), np.uint8)
    flat = np.ascontiguousarray(pixels).reshape(height, 4 * width)
    rows[:, 0] = _SUB
    rows[:, 1:5] = flat[:, :4]
    np.subtract(flat[:, 4:], flat[:, :-4], out=rows[:, 5:])
    packed = isal_zlib.compress(rows, DEFLATE_LEVEL)
    header = struct.pack(">II", width, height) + _RGBA8
    return PNG_SIGNATURE + png_chunk(b"IHDR", header) + png_chunk(b"sRGB", b"\0") + png_chunk(b"IDAT", packed) + png_chunk(b"IEND", b"")


def png_chunk(kind: bytes, data: bytes) -> bytes:
    """A part of a PNG: length, kind, data, checksum."""
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(data, zlib.crc32(kind)))
