"""Exact coverage: the area of the projected silhouette polygon in every pixel.

This work is based on: the stencil setting of Sander et al. 2000, Silhouette Clipping, section 6: the winding number of the
projected silhouette counts the front-facing layers over a point of the image, and the picture is where it is positive.
Departs from it: no stencil and no fans; the area where it is positive is summed pixel by pixel on the CPU.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from schemas.conventions import F8, U1, Array
from service.kernels.coverage import extent
from service.kernels.coverage_rows import columns_of, cover
from service.scratch import ThreadScratch

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


_scratch = ThreadScratch()
USUAL_PIECES = 1 << 14


def cover_scratch(pixels: int) -> tuple[Array, ...]:
    """Scratch of `service.kernels.coverage_rows.cover` for so many pixels, each row filled up; the calling thread's own."""
    state = _scratch.array("state", (pixels,), np.uint8)
    ints = _scratch.array("ints", (3, pixels + 2), np.int32)
    pieces, places = _scratch.array("pieces", (2, USUAL_PIECES, 4), np.float64), _scratch.array("places", (USUAL_PIECES,), np.int32)
    sums = _scratch.array("sums", (pixels,), np.float64)
    return sums, state, state.view(np.uint64), ints[0], ints[1], pieces[0], pieces[1], places, ints[2]


def coverage_mask(segments: F8, width: int, height: int, out: U1 | None = None, base: int = 0) -> Coverage:
    """Covered area of each pixel of a width x height image, from the segments of `project_edges`.

    segments: (s, 4) f8 pixels (xa, ya, xb, yb), y down, that form closed polygons, in any order; covered is where their winding
    number is positive, an edge that runs down the image counting +1 for what is right of it. The area is exact before it is
    rounded to 1/255, but in pixels with more than 8 pieces of edges (sampled at 24 heights) and, where more than
    MOST_PIECES pixels and edges meet, in pixels that go from no layer to several (they may come out too full).
    out: (h, w) u1 C-contiguous, overwritten. base: added to the winding number everywhere (`surrounding_layers`). The kernels
    release the interpreter lock. Raises ValueError for segments that are not finite.
    """
    lines = np.ascontiguousarray(segments, np.float64).reshape(-1, 4)
    if out is None:
        out = np.zeros((height, width), np.uint8)
    out[:] = 0
    x0, y0, x1, y1 = _bounds(lines, width, height)
    if base != 0:
        x0, y0, x1, y1 = 0, 0, width, height
    if x0 >= x1 or y0 >= y1:
        return Coverage(out, (0, 0, 0, 0), 0)
    scratch = cover_scratch((y1 - y0) * columns_of(x1 - x0))
    found, last = cover(lines, np.arange(len(lines), dtype=np.int32), x0, y0, x1, y1, float(base), out, MOST_PIECES, scratch)
    return Coverage(out, (x0, y0, last, y1), found)


def _bounds(lines: F8, width: int, height: int) -> tuple[int, int, int, int]:
    """The pixels that the lines can touch, and the first column when they are left of the image."""
    low_x, low_y, high_x, high_y = extent(lines)
    if not max(-low_x, -low_y, high_x, high_y) <= FARTHEST_PX:
        raise ValueError("segments must be finite")
    x0, y0 = int(min(max(low_x, 0.0), width)), int(min(max(low_y, 0.0), height))
    x1, y1 = int(min(max(np.floor(high_x) + 1.0, 1.0), width)), int(min(max(np.floor(high_y) + 1.0, 0.0), height))
    return x0, y0, x1, y1
