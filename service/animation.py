"""Encoded pictures put together to one file: an animated PNG, an animated WebP, or an archive.

Nothing is encoded again: the files only hold what the pictures hold already. Based on: PNG Specification (Third Edition), 11.3.6, and
WebP Container Specification, "Animation". Every frame is whole and takes the place of the one before.
"""

from __future__ import annotations

import struct
import zipfile
from collections.abc import Iterator, Sequence
from io import BytesIO
from itertools import chain, pairwise

from schemas.sequence import SequenceFormat
from service.render.encode import PNG_SIGNATURE, png_chunk

MADE = (1980, 1, 1, 0, 0, 0)
"""Time of files in archives: equal pictures make equal archives."""
ANIMATED, WITH_ALPHA = 0x02, 0x10
"""Flags of a WebP."""
WHOLE = 0x02
"""Flag of a WebP's frame: it is not blended with the one before."""
OF_A_FRAME = (b"ALPH", b"VP8 ", b"VP8L")


def animation(pictures: Sequence[bytes], form: SequenceFormat, fps: float, loop: int) -> bytes:
    """One file of pictures of one size, WebPs for a WebP and PNGs for the others. loop: times that it is played, 0 for ever."""
    if form is SequenceFormat.ZIP:
        return archive(pictures)
    return (animated_webp if form is SequenceFormat.WEBP else animated_png)(pictures, durations_ms(len(pictures), fps), loop)


def durations_ms(count: int, fps: float) -> list[int]:
    """Of each of so many frames; whole milliseconds that do not drift from the rate."""
    return [max(1, after - before) for before, after in pairwise(round(1000.0 * n / fps) for n in range(count + 1))]


def archive(pictures: Sequence[bytes]) -> bytes:
    """PNGs as 0000.png, 0001.png, ..., not packed again."""
    out = BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_STORED) as file:
        for number, picture in enumerate(pictures):
            file.writestr(zipfile.ZipInfo(f"{number:04d}.png", MADE), picture)
    return out.getvalue()


def animated_png(pictures: Sequence[bytes], durations: Sequence[int], loop: int) -> bytes:
    """PNGs of one size as one; programs that know no animation show the first."""
    before = [(kind, data) for kind, data in _png_chunks(pictures[0]) if kind not in (b"IDAT", b"IEND")]
    size = struct.unpack(">II", before[0][1][:8])
    parts = [PNG_SIGNATURE, png_chunk(*before[0]), png_chunk(b"acTL", struct.pack(">II", len(pictures), loop))]
    parts += [png_chunk(kind, data) for kind, data in before[1:]]
    number = 0
    for first, (picture, ms) in enumerate(zip(pictures, durations, strict=True)):
        parts.append(png_chunk(b"fcTL", struct.pack(">IIIIIHHBB", number, *size, 0, 0, ms, 1000, 0, 0)))
        number += 1
        for kind, data in _png_chunks(picture):
            if kind == b"IDAT" and not first:
                parts.append(png_chunk(b"IDAT", data))
            elif kind == b"IDAT":
                parts.append(png_chunk(b"fdAT", struct.pack(">I", number) + data))
                number += 1
    return b"".join([*parts, png_chunk(b"IEND", b"")])


def _png_chunks(picture: bytes) -> Iterator[tuple[bytes, bytes]]:
    at = len(PNG_SIGNATURE)
    while at < len(picture):
        length, kind = struct.unpack_from(">I4s", picture, at)
        yield kind, picture[at + 8 : at + 8 + length]
        at += 12 + length


def animated_webp(pictures: Sequence[bytes], durations: Sequence[int], loop: int) -> bytes:
    """WebPs of one size as one."""
    chunks = [dict(_webp_chunks(picture)) for picture in pictures]
    width, height = _webp_size(chunks[0])
    canvas = _less_one(width) + _less_one(height)
    frames = (
        _webp_chunk(
            b"ANMF",
            bytes(6) + canvas + struct.pack("<I", ms)[:3] + bytes([WHOLE])
            + b"".join(_webp_chunk(kind, found[kind]) for kind in OF_A_FRAME if kind in found),
        )
        for found, ms in zip(chunks, durations, strict=True)
    )  # fmt: skip
    head = _webp_chunk(b"VP8X", bytes([ANIMATED | WITH_ALPHA, 0, 0, 0]) + canvas), _webp_chunk(b"ANIM", struct.pack("<IH", 0, loop))
    data = b"".join(chain(head, frames))
    return b"RIFF" + struct.pack("<I", 4 + len(data)) + b"WEBP" + data


def _webp_chunks(picture: bytes) -> Iterator[tuple[bytes, bytes]]:
    at = 12
    while at < len(picture):
        kind, length = struct.unpack_from("<4sI", picture, at)
        yield kind, picture[at + 8 : at + 8 + length]
        at += 8 + length + length % 2


def _webp_chunk(kind: bytes, data: bytes) -> bytes:
    return kind + struct.pack("<I", len(data)) + data + bytes(len(data) % 2)


def _webp_size(chunks: dict[bytes, bytes]) -> tuple[int, int]:
    """Of a lossy picture's own header, or a lossless one's."""
    if b"VP8 " in chunks:
        width, height = struct.unpack_from("<HH", chunks[b"VP8 "], 6)
        return width & 0x3FFF, height & 0x3FFF
    bits = int.from_bytes(chunks[b"VP8L"][1:5], "little")
    return (bits & 0x3FFF) + 1, (bits >> 14 & 0x3FFF) + 1


def _less_one(side: int) -> bytes:
    return struct.pack("<I", side - 1)[:3]
