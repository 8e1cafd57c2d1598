"""A small mesh with levels and three hulls to draw, and ladders for it made of numbers."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np

from schemas.ladder import SAMPLES, SIZES, VIEWS, Ladder, MeasuredRung, OutlineError, RungAtSize, ShadingError, Spread, ViewFacts
from schemas.render import Antialias
from service.assets import DrawnHull
from service.rungs import OUTLINE_ERROR_PX
from tests.service.render.made import clippable
from tests.service.render.test_level_frames import leveled


@cache
def many_ways(name="knot"):
    """A shape with levels and hulls of 100 and 400 faces beside its own of 200."""
    others = [clippable(name, faces) for faces in (100, 400)]
    return replace(leveled(name), other_hulls=tuple(DrawnHull(other.hull, other.maps) for other in others))


@cache
def measured(seed=1, device="a device"):
    """The same with a ladder of random numbers."""
    return with_ladder(many_ways(), seed, device)


def with_ladder(asset, seed=1, device="a device"):
    """An asset with a ladder of random numbers for all its rungs."""
    random = np.random.default_rng(seed)
    rungs = [
        MeasuredRung(**key.model_dump(), level_faces=None, sizes=[at_size(random, key.antialias, size) for size in SIZES])
        for key in asset.rungs.keys
    ]
    facts = [ViewFacts(size=size, area_px=0.3 * size**2, silhouette_edges=150.0) for size in SIZES]
    return replace(asset, ladder=Ladder(device=device, views=VIEWS, samples=SAMPLES, facts=facts, rungs=rungs))


def at_size(random, antialias: Antialias, size: int) -> RungAtSize:
    ms = float(random.uniform(1.0, 10.0))
    return RungAtSize(
        size=size,
        bound_px=OUTLINE_ERROR_PX[antialias],
        outline=OutlineError(alpha_error=0.01, alpha_rmse=0.02, distance_px=float(random.uniform(0.1, 1.0)), wrong_pixels=0.0),
        shading=ShadingError(psnr_db=float(random.uniform(20.0, 40.0)), ssim=0.9),
        frame=Spread(p50_ms=ms, p95_ms=1.2 * ms),
        passes={},
    )
