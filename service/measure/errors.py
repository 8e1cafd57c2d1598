"""How far a picture is from the reference.

Outline: the difference of alpha. Its distance in pixels is measured so: in a pixel that a straight edge passes upright, alpha differs
by as much as the edge is displaced, so the largest difference of alpha is taken; where a pixel shows the mesh although no part of it is
there, or the reverse, it is the distance to the nearest pixel where that is right, and the picture's diagonal if there is none. Shading:
colours of pixels that both cover fully. Windows of structural similarity see those pixels and no others, so that no outline comes into it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.ndimage import distance_transform_edt, find_objects, gaussian_filter

from schemas.conventions import F4, F8, U1, Array
from schemas.ladder import OutlineError, ShadingError
from service.kernels.picture_errors import colour_sums, far_pixels, outline_sums

MOST_DB = 99.0
"""Decibels of pictures that are the same."""
SIGMA_PX = 1.5
"""Of the window of structural similarity, as usual."""
STEPS = 4096


def _encoding() -> F4:
    """(STEPS,) f4: sRGB in 0..255 of evenly spaced linear light, not rounded."""
    light = np.linspace(0.0, 1.0, STEPS)
    return (255.0 * np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1.0 / 2.4) - 0.055)).astype(np.float32)


_ENCODED = _encoding()


@dataclass(frozen=True)
class OutlineSums:
    """Sums over the pixels of one picture: see `outline_sums`; distance_px: the largest."""

    error: float
    squares: float
    boundary: int
    wrong: int
    distance_px: float


@dataclass(frozen=True)
class ShadingSums:
    """Sums over the pixels of one picture. squares, bytes: of errors of sRGB bytes; similarity, pixels: of structural similarity."""

    squares: float
    bytes: int
    similarity: float
    pixels: int


@dataclass(frozen=True)
class Distances:
    """Of the pixels of a reference whose alpha is (h, w) f4; worked out once, when a picture is so far off that it needs them."""

    alpha: F4

    @cached_property
    def px(self) -> F8:
        """(h, w) f8 from each full pixel to the nearest that is not, from each empty one to the nearest that is not."""
        return np.where(self.alpha == 0.0, _from(self.alpha == 0.0), _from(self.alpha == 1.0))


def _from(alike: Array) -> F8:
    """(h, w) f8 from each of these pixels, (h, w) bool, to the nearest that is not one."""
    return np.full(alike.shape, math.hypot(*alike.shape)) if alike.all() else np.asarray(distance_transform_edt(alike))


def outline_of(made: U1, true: F4, distances: Distances | None = None) -> OutlineSums:
    """Errors of the alpha of made (h, w, 4) u1 against that of true (h, w, 4) f4. distances: of true, for several pictures."""
    mine, its = np.ascontiguousarray(made[:, :, 3]), np.ascontiguousarray(true[:, :, 3])
    error, squares, boundary, wrong, largest = outline_sums(mine, its)
    far = np.zeros(mine.shape, np.bool_)
    if far_pixels(mine, its, far):
        largest = max(largest, float((distances or Distances(its)).px[far].max()))
    return OutlineSums(error, squares, boundary, wrong, largest)


def shading_of(made: U1, true: F4) -> ShadingSums:
    """Errors of the colours of made (h, w, 4) u1 sRGB, straight, against true (h, w, 4) f4 linear, premultiplied."""
    luma, mask = np.empty((2, *made.shape[:2]), np.float32), np.empty(made.shape[:2], np.float32)
    squares, count = colour_sums(np.ascontiguousarray(made), true, _ENCODED, luma, mask)
    if not count:
        return ShadingSums(0.0, 0, 0.0, 0)
    around = find_objects(mask.astype(np.int8))[0]
    similarity = structural_similarity(luma[0][around], luma[1][around], mask[around])
    return ShadingSums(squares, count, float(similarity.sum(dtype=np.float64)), len(similarity))


def structural_similarity(a: F4, b: F4, mask: F4) -> F4:
    """(n,) f4 at the pixels where mask (h, w) f4 is 1, of two pictures (h, w) f4 of 0..255 that are 0 where it is 0.

    Wang, Bovik, Sheikh, Simoncelli 2004, with their constants and window; a window's weights are shared out among the pixels of the mask.
    """
    c1, c2 = (0.01 * 255.0) ** 2, (0.03 * 255.0) ** 2
    inside = mask > 0.0
    weights, *sums = (
        gaussian_filter(picture, SIGMA_PX, mode="constant", truncate=3.5)[inside] for picture in (mask, a, b, a * a, b * b, a * b)
    )
    mean_a, mean_b, aa, bb, ab = (one / weights for one in sums)
    var_a, var_b, both = aa - mean_a**2, bb - mean_b**2, ab - mean_a * mean_b
    similar = (2.0 * mean_a * mean_b + c1) * (2.0 * both + c2) / ((mean_a**2 + mean_b**2 + c1) * (var_a + var_b + c2))
    return np.asarray(similar, np.float32)


def outline_error(sums: list[OutlineSums]) -> OutlineError:
    """Over several pictures."""
    boundary = max(1, sum(one.boundary for one in sums))
    return OutlineError(
        alpha_error=sum(one.error for one in sums) / boundary,
        alpha_rmse=math.sqrt(sum(one.squares for one in sums) / boundary),
        distance_px=max((one.distance_px for one in sums), default=0.0),
        wrong_pixels=sum(one.wrong for one in sums) / max(1, len(sums)),
    )


def shading_error(sums: list[ShadingSums]) -> ShadingError:
    """Over several pictures; those without a pixel that both cover fully say nothing."""
    count, pixels = sum(one.bytes for one in sums), sum(one.pixels for one in sums)
    mean = sum(one.squares for one in sums) / max(1, count)
    decibels = MOST_DB if mean <= 0.0 else min(MOST_DB, 10.0 * math.log10(255.0**2 / mean))
    return ShadingError(psnr_db=decibels, ssim=sum(one.similarity for one in sums) / pixels if pixels else 1.0)
