"""The contours as closed polygons of an image, clipped at the eye plane and, far outside the image, at a frame about it."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from schemas.conventions import F8, I4
from service.camera import View
from service.kernels import clip as clip_kernels
from service.kernels import clip_loops as kernels

MARGIN_PX = 64.0
"""Polygons reach at least so far beyond the image before they are cut off: lines along the cuts must not show."""


@dataclass(frozen=True)
class Outline:
    """Closed polygons whose winding number in the image is the number of front-facing layers.

    points: (n, 2) f8 pixels, y down. offsets: (c + 1,) i4, polygon i is points[offsets[i]:offsets[i + 1]]. inner: (n, 2, 2) f8, the
    control points of the cubic curve from each point to the next; None where the sides are straight.
    """

    points: F8
    offsets: I4
    inner: F8 | None = None

    def polygons(self) -> list[F8]:
        """The polygons one by one."""
        return [self.points[a:b] for a, b in pairwise(self.offsets)]

    def curves(self) -> list[F8]:
        """The polygons as cubic curves, (3 n, 2) each: point, two control points, point, ..., two control points."""
        found = []
        for a, b in pairwise(self.offsets):
            points = self.points[a:b]
            if self.inner is None:
                side = np.roll(points, -1, axis=0) - points
                inner = points[:, None] + side[:, None] * np.array([[1.0], [2.0]]) / 3.0
            else:
                inner = self.inner[a:b]
            found.append(np.concatenate([points[:, None], inner], axis=1).reshape(-1, 2))
        return found


def outline_of(view: View, corners: F8, offsets: I4, base: int = 0) -> Outline:
    """Polygons of closed loops in the image of `view`.

    corners: (n, 3) f8 (u, v, w) of the loops' points one after the other, u / w and v / w in pixels; loop i is
    corners[offsets[i]:offsets[i + 1]]. base: layers that fill the whole image (`surrounding_layers`).
    Loops with nothing behind the eye and nothing far from the image keep their points; all others are clipped.
    """
    width, height = float(view.width), float(view.height)
    margin = MARGIN_PX + max(width, height)
    if base <= 0 and is_within(view, corners):
        return Outline(corners[:, :2] / corners[:, 2:], offsets)
    ends = list(pairwise(offsets))
    cuts, count = np.empty((len(corners), 3)), 0
    for a, b in ends:
        count = kernels.eye_plane_cuts(corners[a:b], cuts, count)
    angle, radius = clip_kernels.hub_of(cuts[:count], width, height)
    polygons = [_filling(width, height, margin)] * max(base, 0)
    polygons += [kernels.clip_loop(corners[a:b], width, height, margin, angle, radius) for a, b in ends]
    polygons = [p for p in polygons if len(p)]
    sizes = np.cumsum([0, *(len(p) for p in polygons)], dtype=np.int32)
    return Outline(np.concatenate(polygons) if polygons else np.empty((0, 2)), sizes)


def is_within(view: View, corners: F8) -> bool:
    """Whether all corners (n, 3) f8 (u, v, w) are before the eye and so near the image that none need be cut off."""
    width, height = float(view.width), float(view.height)
    margin = MARGIN_PX + max(width, height)
    u, v, w = corners[:, 0], corners[:, 1], corners[:, 2]
    return bool(
        np.all(w >= clip_kernels.EYE_PLANE)
        and np.all(np.abs(2.0 * u - width * w) <= (width + 2.0 * margin) * w)
        and np.all(np.abs(2.0 * v - height * w) <= (height + 2.0 * margin) * w)
    )


def _filling(width: float, height: float, margin: float) -> F8:
    """A polygon round the image, in the positive sense: down on the left."""
    left, top, right, bottom = -margin, -margin, width + margin, height + margin
    return np.array([[left, top], [left, bottom], [right, bottom], [right, top]])
