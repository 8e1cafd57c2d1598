"""Small loops out of large contours."""

from __future__ import annotations

import numpy as np
from numba import njit


@njit(cache=True, nogil=True)
def triangle_loops(offsets):
    """(t, 3) i4: triangles whose oriented boundaries add up to the contours; indices into the contours' vertices.

    offsets (c + 1,) integers: contour k has the vertices [offsets[k], offsets[k + 1]). Silhouette Clipping, section 6, splits
    a contour by adding two opposing edges between two of its vertices, and draws the small loops as fans about their
    centroids. Here the splitting goes on until every loop is a triangle, which needs no centroid: every other vertex is cut
    off by a chord, then the same is done to the contour of the chords. Triangles are short where the contour is fine, and
    each level halves their number.

        o---o          o---o
       /     \\        / `. \\
      o       o  ->  o----`o   and so on inside
    """
    total = 0
    longest = 0
    for c in range(offsets.shape[0] - 1):
        n = offsets[c + 1] - offsets[c]
        total += max(n - 2, 0)
        longest = max(longest, n)
    out = np.empty((total, 3), np.int32)
    left = np.empty(longest, np.int32)
    t = 0
    for c in range(offsets.shape[0] - 1):
        n = offsets[c + 1] - offsets[c]
        for i in range(n):
            left[i] = offsets[c] + i
        while n > 2:
            kept = 0
            for i in range(0, n - 1, 2):
                out[t, 0], out[t, 1], out[t, 2] = left[i], left[i + 1], left[(i + 2) % n]
                t += 1
                left[kept] = left[i]
                kept += 1
            if n % 2 == 1:
                left[kept] = left[n - 1]
                kept += 1
            n = kept
    return out
