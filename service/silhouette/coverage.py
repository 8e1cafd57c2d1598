"""Exact coverage: the area of the projected silhouette polygon in every pixel.

This work is based on: the stencil setting of Sander et al. 2000, Silhouette Clipping, section 6: the winding number of the
projected silhouette counts the front-facing layers over a point of the image, and the picture is where it is positive.
Departs from it: no stencil and no fans; the area where it is positive is summed pixel by pixel on the CPU.
"""

from __future__ import annotations

import threading
from dataclasses import dataclass

import numpy as np

from schemas.conventions import F8, U1, Array
from service.kernels import coverage as kernels
from service.kernels import coverage_pixels
from service.scratch import Scratch

MOST_PIECES = 1 << 20
"""Pieces of edges held at a time: 40 MiB. Images with more are drawn in several goes."""
FARTHEST_PX = 1e150
"""Coordinates beyond this would overflow in products."""


@dataclass(frozen=True)
class Coverage:
    """How much of each pixel is covered.

    mask: (h, w) u1, 255 for all of it, row 0 at the top. bounds: (x0, y0, x1, y1) in pixels, half-open; outside it the mask is
    0, and (0, 0, 0, 0) means that nothing is in the image. doubtful: pixels several chains of edges cross, treated one by one.
    """

    mask: U1
    bounds: tuple[int, int, int, int]
    doubtful: int


class _Scratch(threading.local, Scratch):
    """Buffers of each thread."""


_scratch = _Scratch()


def coverage_mask(segments: F8, width: int, height: int, out: U1 | None = None, base: int = 0) -> Coverage:
    """Covered area of each pixel of a width x height image, from the segments of `project_edges`.

    segments: (s, 4) f8 pixels (xa, ya, xb, yb), y down, that form closed polygons, in any order; covered is where their winding
    number is positive, an edge that runs down the image counting +1 for what is right of it. The area is exact before it is
    rounded to 1/255, but in pixels with more than 8 pieces of edges (sampled at 20 heights) and, where more than
    MOST_PIECES pixels and edges meet, in pixels that go from no layer to several (they may come out too full).
    out: (h, w) u1 C-contiguous, overwritten. base: added to the winding number everywhere (`surrounding_layers`).
    The kernels release the interpreter lock. Raises ValueError for segments that are not finite.
    """
    lines = np.ascontiguousarray(segments, np.float64).reshape(-1, 4)
    if out is None:
        out = np.zeros((height, width), np.uint8)
    else:
        out[...] = 0
    x0, y0, x1, y1 = _bounds(lines, width, height)
    if base != 0:
        x0, y0, x1, y1 = 0, 0, width, height
    if x0 >= x1 or y0 >= y1:
        return Coverage(out, (0, 0, 0, 0), 0)
    shape = (y1 - y0, (x1 - x0 + 8) // 8 * 8)
    sums, state = _scratch.array("sums", shape, np.float64), _scratch.array("state", shape, np.uint8)
    state[...] = 0
    room = int(min(MOST_PIECES, kernels.most_pieces(lines, width, height)))
    pieces, pixels = _scratch.array("pieces", (room, 4), np.float64), _scratch.array("pixels", (room, 2), np.int32)
    start, goes, count = 0, 0, 0
    while start < len(lines):
        count, start = kernels.cut(lines, start, width, y0, y1, pieces, pixels)
        kernels.accumulate(pieces, pixels, count, x0, y0, sums, state)
        goes += 1
    doubtful = _scratch.array("doubtful", (min(room * goes, state.size),), np.int32)
    found, end = kernels.sweep(sums, state, state.view(np.uint64), float(base), out, x0, y0, x1, y1, doubtful)
    if found and goes == 1:
        _resolve(pieces[:count], pixels, (x0, y0), sums, state, doubtful[:found], out)
    return Coverage(out, (x0, y0, end, y1), found)


def _resolve(pieces: Array, pixels: Array, corner: tuple[int, int], sums: Array, state: Array, doubtful: Array, out: U1) -> None:
    """Give the doubtful pixels their covered area, from the pieces that cross them."""
    number = _scratch.array("number", (state.size,), np.int32)
    offsets, owner = _scratch.array("offsets", (len(doubtful) + 2,), np.int32), _scratch.array("owner", (len(pieces),), np.int32)
    own = _scratch.array("own", pieces.shape, np.float64)
    most = coverage_pixels.gather(pieces, pixels, *corner, state, doubtful, number, offsets, owner, own)
    coverage_pixels.resolve(own, offsets, most, doubtful, sums.reshape(-1), state.shape[1], out, *corner)


def _bounds(lines: F8, width: int, height: int) -> tuple[int, int, int, int]:
    """The pixels these lines can touch, and the first column when they are left of the image."""
    low_x, low_y, high_x, high_y = kernels.extent(lines)
    if not max(-low_x, -low_y, high_x, high_y) <= FARTHEST_PX:
        raise ValueError("segments must be finite")
    x0, y0 = int(min(max(low_x, 0.0), width)), int(min(max(low_y, 0.0), height))
    x1, y1 = int(min(max(np.floor(high_x) + 1.0, 1.0), width)), int(min(max(np.floor(high_y) + 1.0, 0.0), height))
    return x0, y0, x1, y1
