"""Measuring every rung of a mesh, view by view, and putting the ladder together.

Errors factor: the outline does not depend on which hull is drawn, nor on its maps; the colour of what is fully covered does not depend
on the outline. So outlines are compared once for each antialiasing and level, and shading once for each hull and size of maps; every rung
is drawn for its times.
"""

from __future__ import annotations

import statistics
from collections import defaultdict
from collections.abc import Iterable
from typing import NamedTuple

from pydantic import BaseModel

from schemas.errors import CapabilityError
from schemas.ladder import SAMPLES, SIZES, VIEWS, Ladder, MeasuredRung, RungAtSize, Spread, ViewFacts
from schemas.render import Accuracy, Antialias, AnyCamera, RenderRequest, Source
from service.assets import MeshAsset
from service.measure.errors import OutlineSums, ShadingSums, outline_error, outline_of, shading_error, shading_of
from service.measure.reference import reference
from service.measure.views import spread_view
from service.render.frame import RenderedImage, render_frame
from service.render.state import Gpu
from service.rungs import Rung, RungTable


class Step(NamedTuple):
    """A view at a size: what is measured at once."""

    size: int
    view: int


class RungInView(BaseModel):
    """What a rung did in one view. ms: of the frame; passes: of each. bound_px: certified, None where nothing is."""

    ms: float
    passes: dict[str, float]
    bound_px: float | None


class Measured(BaseModel):
    """One view at one size. rungs: by number; outlines, shadings: by the names of `outline_factor` and `shading_factor`."""

    size: int
    view: int
    area_px: int
    silhouette_edges: int
    rungs: dict[int, RungInView]
    outlines: dict[str, tuple[float, float, int, int, float]]
    shadings: dict[str, tuple[float, int, float, int]]


def steps(views: int = VIEWS, sizes: Iterable[int] = SIZES) -> list[Step]:
    """Everything there is to measure."""
    return [Step(size, view) for view in range(views) for size in sizes]


def explicit(table: RungTable, number: int) -> Accuracy:
    """The rung of that number, as a request names it."""
    key = table.keys[number]
    if key.source is Source.ORIGINAL:
        return Accuracy(source=key.source, antialias=key.antialias)
    level = -1 if key.level is None else key.level
    return Accuracy(source=key.source, antialias=key.antialias, level=level, hull_faces=key.hull_faces, texels=key.texels)


def outline_factor(rung: Rung) -> str:
    """What the outline of a rung depends on."""
    return f"{rung.source.value}/{rung.antialias.value}/{'mesh' if rung.level is None else rung.level}"


def shading_factor(rung: Rung) -> str:
    """What the shading of a rung depends on: of the original, how it is sampled."""
    if rung.hull is None:
        return f"original/{rung.antialias.value}"
    return f"hull {rung.hull}/{rung.halvings}"


def measure_step(gpu: Gpu, asset: MeshAsset, step: Step, views: int = VIEWS) -> Measured:
    """Draw every rung in one view and compare. Rungs that this view refuses are left out."""
    camera = spread_view(step.view, views)
    true = reference(gpu, asset, camera, step.size)
    outlines: dict[str, OutlineSums] = {}
    shadings: dict[str, ShadingSums] = {}
    rungs: dict[int, RungInView] = {}
    area = edges = 0
    for number, rung in enumerate(asset.rungs.rungs):
        image = _drawn(gpu, asset, number, camera, step.size, warm=step.view == 0)
        if image is None or image.planned is None:
            continue
        area, certified = image.planned.area.pixels, image.planned.choice.bound == "certified"
        edges = image.edges if rung.level is None and image.edges else edges
        rungs[number] = RungInView(ms=image.ms, passes=dict(image.passes), bound_px=image.error_px if certified else None)
        if outline_factor(rung) not in outlines:
            outlines[outline_factor(rung)] = outline_of(image.pixels, true)
        if _shows_shading(rung) and shading_factor(rung) not in shadings:
            shadings[shading_factor(rung)] = shading_of(image.pixels, true)
    return Measured(
        size=step.size,
        view=step.view,
        area_px=area,
        silhouette_edges=edges,
        rungs=rungs,
        outlines={name: (s.error, s.squares, s.boundary, s.wrong, s.distance_px) for name, s in outlines.items()},
        shadings={name: (s.squares, s.bytes, s.similarity, s.pixels) for name, s in shadings.items()},
    )


def put_together(asset: MeshAsset, device: str, measured: list[Measured], views: int = VIEWS) -> Ladder:
    """The ladder of all steps. Rungs that no view allowed are not in it."""
    by_size: dict[int, list[Measured]] = defaultdict(list)
    for one in measured:
        by_size[one.size].append(one)
    rungs = []
    for number, key in enumerate(asset.rungs.keys):
        sizes = [_at_size(asset.rungs.rungs[number], number, size, of_size) for size, of_size in sorted(by_size.items())]
        if all(at is not None for at in sizes):
            faces = len(asset.faces) if key.level is None else asset.rungs.level_faces[key.level]
            rungs.append(MeasuredRung(**key.model_dump(), level_faces=faces, sizes=[at for at in sizes if at is not None]))
    facts = [
        ViewFacts(
            size=size,
            area_px=statistics.median(one.area_px for one in of_size),
            silhouette_edges=statistics.median(one.silhouette_edges for one in of_size),
        )
        for size, of_size in sorted(by_size.items())
    ]
    return Ladder(device=device, views=views, samples=SAMPLES, facts=facts, rungs=rungs)


def _drawn(gpu: Gpu, asset: MeshAsset, number: int, camera: AnyCamera, size: int, *, warm: bool) -> RenderedImage | None:
    """A picture on a rung, the second of two where the first has to compile and upload; None where the view refuses the rung."""
    request = RenderRequest(camera=camera, width=size, height=size, accuracy=explicit(asset.rungs, number))
    try:
        for _ in range(2 if warm else 1):
            image = render_frame(gpu, asset, request, wait_each=True)
    except CapabilityError:
        return None
    return image


def _shows_shading(rung: Rung) -> bool:
    """Whether pictures of this rung stand for the shading of all that share its factor."""
    return rung.hull is None or (rung.antialias is Antialias.COVERAGE and rung.level is None)


def _at_size(rung: Rung, number: int, size: int, measured: list[Measured]) -> RungAtSize | None:
    drawn = [one.rungs[number] for one in measured if number in one.rungs]
    if not drawn:
        return None
    outlines = [OutlineSums(*one.outlines[outline_factor(rung)]) for one in measured if outline_factor(rung) in one.outlines]
    shadings = [ShadingSums(*one.shadings[shading_factor(rung)]) for one in measured if shading_factor(rung) in one.shadings]
    names = {name: None for one in drawn for name in one.passes}
    bounds = [one.bound_px for one in drawn if one.bound_px is not None]
    return RungAtSize(
        size=size,
        bound_px=max(bounds) if len(bounds) == len(drawn) else None,
        outline=outline_error(outlines),
        shading=shading_error(shadings),
        frame=spread([one.ms for one in drawn]),
        passes={name: spread([one.passes[name] for one in drawn if name in one.passes]) for name in names},
    )


def spread(values: list[float]) -> Spread:
    """Median and 95th percentile."""
    ordered = sorted(values)
    return Spread(p50_ms=statistics.median(ordered), p95_ms=ordered[min(len(ordered) - 1, round(0.95 * (len(ordered) - 1)))])
