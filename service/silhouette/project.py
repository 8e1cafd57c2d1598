"""Silhouette edges in the image: projection, and clipping at the eye plane.

A silhouette with parts behind the eye is an open polygon in the image: its contours leave through the eye plane and come
back through it. What closes it is the outline of the front-facing surface in the eye plane itself, which is not at hand,
but lies infinitely far out in the image. There, curves differ only in how often they run round the image. When the eye
is outside the convex hull they do not run round it at all, so any path that takes the shorter way is right; when the eye
is inside, all of the image may be short of a whole number of layers, which `surrounding_layers` finds with one ray.
This work is based on: Sander et al. 2000, Silhouette Clipping, section 6 (there: correct while the eye is outside the hull).
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from schemas.conventions import F4, F8, I4, Array
from schemas.errors import InvalidRequestError
from service.camera import View
from service.kernels import clip as kernels
from service.kernels import clip_layers
from service.threads import cores, side_by_side

EDGES_A_CORE = 4096
"""Fewer are projected in less time than it takes to wake a thread."""
TOUCHING = 1e-9
"""Normalised units: an eye so near to a face is on it."""
RAYS = ((0.4637, 0.5319), (0.2713, 0.3491), (0.7129, 0.6373))
"""Where rays are shot to count layers, in parts of the image: away from its lines of symmetry."""


def project_edges(view: View, positions: F4, edges: I4) -> F8:
    """Segments whose winding number is the number of front-facing layers, for `coverage_mask`.

    positions: (v, 3) f4 normalised. edges: (s, 2) i4 directed, the front-facing side on the left seen from outside; all edges
    of the silhouette of a closed mesh. Returns (n, 4) f8 pixels (xa, ya, xb, yb), y down: the projected edges, without what
    can cover nothing in the image (above, below, right of it), closed where they pass behind the eye. n is not s.
    The winding number is right for an eye outside the convex hull, however much of the mesh is behind it, and for an eye
    anywhere when nothing is behind it. Otherwise add `surrounding_layers`. A surface nearer to the eye than 1e-10
    normalised units may be missing.
    """
    return _segments(view, pixel_matrix(view), positions, edges)


def project_loops(view: View, corners: F8, offsets: I4) -> F8:
    """The same of closed loops of points that are projected already.

    corners: (n, 3) f8 (u, v, w), u / w and v / w in pixels; loop i is corners[offsets[i]:offsets[i + 1]].
    """
    edges = np.column_stack([np.arange(len(corners), dtype=np.int32), following(offsets)])
    return _segments(view, np.eye(3, 4), corners, edges)


def following(offsets: I4) -> I4:
    """(n,) i4: the number of the next point in its loop; loop i has the points [offsets[i], offsets[i + 1])."""
    after = np.arange(1, offsets[-1] + 1, dtype=np.int32)
    after[offsets[1:] - 1] = offsets[:-1]
    return after


def _segments(view: View, matrix: F8, positions: Array, edges: I4) -> F8:
    width, height = float(view.width), float(view.height)
    out = np.empty((2 * len(edges), 4))
    n = _project_in_front(matrix, positions, edges, (width, height), out)
    if n >= 0:
        return out[:n]
    crossing = 0 if view.orthographic else kernels.count_crossings(matrix, positions, edges)
    out = np.empty((2 * len(edges) + 16 * crossing, 4))
    cuts = np.empty((crossing, 3))
    n, _ = kernels.project_edges(matrix, positions, edges, width, height, out, cuts)
    if crossing:
        n = kernels.close_cuts(cuts, width, height, out, n)
    return out[:n]


def _project_in_front(matrix: F8, positions: Array, edges: I4, size: tuple[float, float], out: F8) -> int:
    """`service.kernels.clip.project_in_front` of all edges, by all cores where they are many; returns how many rows, or -1."""
    parts = min(cores(), max(1, len(edges) // EDGES_A_CORE))
    spans = pairwise([len(edges) * part // parts for part in range(parts + 1)])

    def project() -> tuple[int, int]:
        first, last = next(spans)
        return first, kernels.project_in_front(matrix, positions, edges, first, last, *size, out)

    n = 0
    for first, end in sorted(side_by_side(project, parts)):
        if end < 0:
            return -1
        if n < first:
            out[n : n + end - first] = out[first:end]
        n += end - first
    return n


def surrounding_layers(view: View, positions: F4, faces: I4, segments: F8) -> int:
    """Layers that cover the whole image and that `segments` (of `project_edges`) do not know of: `base` of `coverage_mask`.

    Needed only when the eye is inside the convex hull, that is never when it is outside the unit sphere. Walks all faces (f, 3) i4
    once. Counts along three rays and takes the middle count, so that a ray through an edge does no harm.
    Raises InvalidRequestError for an eye on the surface: the face that it is on counts as front-facing and is met by no ray.
    """
    if clip_layers.touches(positions, faces, view.eye, TOUCHING):
        raise InvalidRequestError("the eye is on the surface of the mesh, whose outline has no inside from there", field="camera")
    matrix = pixel_matrix(view)
    counts = []
    for x, y in RAYS:
        px, py = x * view.width, y * view.height
        counts.append(int(clip_layers.front_layers(matrix, positions, faces, px, py)) - int(clip_layers.winding(segments, px, py)))
    return sorted(counts)[1]


def pixel_matrix(view: View) -> F8:
    """(3, 4) f8: homogeneous pixels (u, v, w) from the normalised frame; u / w to the right, v / w down."""
    return view.pixels[[0, 1, 3]]
