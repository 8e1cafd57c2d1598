"""Exact coverage: the area of the projected silhouette polygon in every pixel.

This work is based on: the stencil setting of Sander et al. 2000, Silhouette Clipping, section 6: the winding number of the
projected silhouette counts the front-facing layers over a point of the image, and the picture is where it is positive.
Departs from it: no stencil and no fans; the area where it is positive is summed pixel by pixel on the CPU.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from schemas.conventions import F8, U1
from service.kernels import coverage as kernels
from service.kernels import coverage_pixels

MOST_PIECES = 1 << 21
"""Edge pieces kept for the exact treatment of doubtful pixels: 72 MiB. An image that needs more keeps clamped sums."""
MOST_PIXELS = 1e150
"""Coordinates beyond this would overflow in products."""


@dataclass(frozen=True)
class Coverage:
    """mask: (h, w) u1, 255 where a pixel is covered, row 0 at the top. bounds: (x0, y0, x1, y1), half-open, in pixels;
    everything outside is 0 and x0 == x1 when all of it is. doubtful: pixels that several contours cross.
    """

    mask: U1
    bounds: tuple[int, int, int, int]
    doubtful: int


def coverage_mask(segments: F8, width: int, height: int, out: U1 | None = None, base: int = 0) -> Coverage:
    """Covered area of each pixel of a width x height image, from the segments of `project_edges`.

    segments: (s, 4) f8 pixels (xa, ya, xb, yb), y down, that form closed polygons; covered is where their winding number is
    positive, an edge that runs down counting +1 for what is right of it. Rounded to 1/255. Exact, but for pixels with more
    than 12 pieces of edges (their heights are sampled 32 times) and images with more than MOST_PIECES pieces.
    out: (h, w) u1 C-contiguous, overwritten. base: added to the winding number everywhere (`surrounding_layers`).
    Never holds the interpreter lock while it works. Raises ValueError for segments that are not finite.
    """
    lines = np.ascontiguousarray(segments, np.float64).reshape(-1, 4)
    if out is None:
        mask = np.zeros((height, width), np.uint8)
    else:
        mask = out
        mask[...] = 0
    bounds = _bounds(lines, width, height) if base == 0 else (0, 0, width, height)
    x0, y0, x1, y1 = bounds
    if x0 >= x1 or y0 >= y1:
        return Coverage(mask, (0, 0, 0, 0), 0)
    shape = (y1 - y0, (x1 - x0 + 8) // 8 * 8)
    sums, state = np.empty(shape), np.zeros(shape, np.uint8)
    capacity = int(min(MOST_PIECES, kernels.count_pieces(lines, width, height)))
    pieces, cells = np.empty((capacity, 4)), np.empty(capacity, np.int32)
    count = kernels.accumulate(lines, width, x0, y0, y1, sums, state, pieces, cells)
    doubtful = np.empty(min(capacity, shape[0] * shape[1]), np.int32)
    found = kernels.sweep(sums, state, state.view(np.uint64), float(base), mask, x0, y0, x1, y1, doubtful)
    if found and count <= capacity:
        number = np.empty(state.size, np.int32)
        own, offsets = coverage_pixels.gather(pieces[:count], cells[:count], state.reshape(-1), doubtful[:found], number)
        coverage_pixels.resolve(own, offsets, doubtful[:found], sums.reshape(-1), shape[1], mask, x0, y0)
    return Coverage(mask, bounds, found)


def _bounds(lines: F8, width: int, height: int) -> tuple[int, int, int, int]:
    """Pixels the polygons can touch."""
    low_x, low_y, high_x, high_y = kernels.extent(lines)
    if not max(-low_x, -low_y, high_x, high_y) <= MOST_PIXELS:
        raise ValueError("segments must be finite")
    x0, y0 = int(min(max(low_x, 0.0), width)), int(min(max(low_y, 0.0), height))
    x1, y1 = int(min(max(np.floor(high_x) + 1.0, 0.0), width)), int(min(max(np.floor(high_y) + 1.0, 0.0), height))
    return x0, y0, x1, y1
