"""Ladders and reports made of plausible numbers: nothing is built or drawn."""

from __future__ import annotations

import numpy as np

from schemas.ladder import SAMPLES, SIZES, VIEWS, Ladder, MeasuredRung, OutlineError, RungAtSize, RungKey, ShadingError, Spread, ViewFacts
from schemas.render import Antialias, Source
from service.accuracy.report import accuracy_report

ID = "0" * 32
COST = {Antialias.NONE: 1.5, Antialias.LINE: 4.0, Antialias.COVERAGE: 1.0, Antialias.MSAA: 12.0, Antialias.SSAA: 25.0}
ERROR = {Antialias.NONE: 0.2, Antialias.LINE: 0.02, Antialias.COVERAGE: 0.003, Antialias.MSAA: 0.07, Antialias.SSAA: 0.024}
ORIGINALS = [RungKey(source=Source.ORIGINAL, antialias=antialias) for antialias in COST if antialias is not Antialias.LINE]
CLIPPED = [
    RungKey(source=Source.CLIPPED, antialias=antialias, level=level, hull_faces=faces, texels=texels)
    for faces in (1000, 250, 4000, 500, 2000)
    for texels in (1012, 529, 286)
    for level in (None, 0, 1, 2)
    for antialias in (Antialias.NONE, Antialias.LINE, Antialias.COVERAGE)
]


def a_ladder(count=100, seed=1, device="a device"):
    """A ladder of so many rungs, at most 184, whose errors and times go as real ones do."""
    random = np.random.default_rng(seed)
    keys = [*ORIGINALS, *CLIPPED][:count]
    rungs = [MeasuredRung(**key.model_dump(), sizes=[at_size(random, key, size) for size in SIZES]) for key in keys]
    facts = [ViewFacts(size=size, area_px=0.3 * size**2, silhouette_edges=150.0) for size in SIZES]
    return Ladder(device=device, views=VIEWS, samples=SAMPLES, facts=facts, rungs=rungs)


def at_size(random, key, size):
    faces = key.hull_faces or 100_000
    ms = COST[key.antialias] * (2.0 + 0.0002 * faces) * (size / 512) * float(random.uniform(0.9, 1.3))
    error = ERROR[key.antialias] + (0.0 if key.level is None else 0.03 * 3.0**key.level)
    psnr = 8.0 + 2.5 * np.log2(faces) - 100.0 / (key.texels or 1000) + float(random.normal())
    return RungAtSize(
        size=size,
        bound_px=None if key.antialias is Antialias.LINE else 0.7,
        outline=OutlineError(alpha_error=error, alpha_rmse=1.5 * error, distance_px=0.4, wrong_pixels=3.0),
        shading=ShadingError(psnr_db=float(psnr), ssim=0.95),
        frame=Spread(p50_ms=ms, p95_ms=1.2 * ms),
        passes={"surface": Spread(p50_ms=0.6 * ms, p95_ms=0.7 * ms)},
    )


def a_report(count=100, *, name="knot.ply", size=None, device=None, predicted=None, seed=1):
    """The report of such a ladder."""
    return accuracy_report(ID, name, a_ladder(count, seed), size, device, predicted or {})


def changed(ladder, number, **outline):
    """The ladder with other outline errors of one rung."""
    rung = ladder.rungs[number]
    sizes = [at.model_copy(update={"outline": at.outline.model_copy(update=outline)}) for at in rung.sizes]
    rungs = [*ladder.rungs[:number], rung.model_copy(update={"sizes": sizes}), *ladder.rungs[number + 1 :]]
    return ladder.model_copy(update={"rungs": rungs})
