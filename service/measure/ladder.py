"""Measuring every rung of a mesh, view by view, and putting the ladder together.

Errors factor: the outline does not depend on which hull is drawn, nor on its maps, but where a level without antialiasing ends at the
hull; the colour of what is fully covered does not depend on the outline. So outlines are compared once for each antialiasing and level,
and shading once for each hull and size of maps; every rung is drawn for its times.

Rungs that draw the same surface in the same way are drawn one after the other, and before the first of them comes a frame that does not
count: as for a client that turns a mesh, whose frames find in the caches what the one before left.
"""

from __future__ import annotations

import statistics
from collections import defaultdict
from collections.abc import Iterable
from typing import Annotated, NamedTuple

from pydantic import BaseModel, Field, FiniteFloat

from schemas.conventions import U1
from schemas.errors import CapabilityError
from schemas.ladder import SAMPLES, SIZES, VIEWS, Ladder, MeasuredRung, RungAtSize, Spread, ViewFacts
from schemas.render import Accuracy, Antialias, AnyCamera, RenderRequest, Source
from service.assets import MeshAsset
from service.measure.errors import Distances, OutlineSums, ShadingSums, outline_error, outline_of, shading_error, shading_of
from service.measure.reference import reference
from service.measure.views import spread_view
from service.render.frame import RenderedImage, render_frame
from service.render.state import Gpu
from service.rungs import ANTIALIAS_CODE, SOURCE_CODE, Rung, RungTable


class Step(NamedTuple):
    """A view at a size: what is measured at once."""

    size: int
    view: int


Amount = Annotated[FiniteFloat, Field(ge=0.0)]
Count = Annotated[int, Field(ge=0)]


class RungInView(BaseModel):
    """What a rung did in one view. ms: of the frame; passes: of each. bound_px: certified, None where nothing is."""

    ms: Amount
    passes: dict[str, Amount]
    bound_px: Amount | None


class Measured(BaseModel):
    """One view at one size. rungs: by number; outlines, shadings: by the names of `outline_factor` and `shading_factor`."""

    size: Count
    view: Count
    area_px: Count
    silhouette_edges: Count
    rungs: dict[int, RungInView]
    outlines: dict[str, tuple[Amount, Amount, Count, Count, Amount]]
    shadings: dict[str, tuple[Amount, Count, FiniteFloat, Count]]


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
    """What the outline of a rung depends on. A level's may leave the hull, and only `none` draws nothing beside a hull."""
    hull = f"/hull {rung.hull}" if rung.antialias is Antialias.NONE and rung.level is not None else ""
    return f"{rung.source.value}/{rung.antialias.value}/{'mesh' if rung.level is None else rung.level}{hull}"


def shading_factor(rung: Rung) -> str:
    """What the shading of a rung depends on: of the original, how it is sampled."""
    if rung.hull is None:
        return f"original/{rung.antialias.value}"
    return f"hull {rung.hull}/{rung.halvings}"


def measure_step(gpu: Gpu, asset: MeshAsset, step: Step, views: int = VIEWS, *, first: bool = True) -> Measured:
    """Draw every rung in one view and compare. Rungs that this view refuses are left out.

    first: of this size since the GL was made, so that every rung may have something to compile or upload.
    """
    camera = spread_view(step.view, views)
    true = reference(gpu, asset, camera, step.size)
    distances = Distances(true[:, :, 3])
    outlines: dict[str, OutlineSums] = {}
    shown: dict[str, U1] = {}
    rungs: dict[int, RungInView] = {}
    area = edges = 0
    before: tuple[int, ...] = ()
    for number, rung in sorted(enumerate(asset.rungs.rungs), key=lambda pair: _turn(pair[1])):
        image = _drawn(gpu, asset, number, camera, step.size, warm=first or _turn(rung)[:-1] != before)
        before = _turn(rung)[:-1]
        if image is None:
            continue
        assert image.planned is not None
        area, certified = image.planned.area.pixels, image.planned.choice.bound == "certified"
        edges = image.edges if rung.level is None and image.edges else edges
        rungs[number] = RungInView(ms=image.ms, passes=dict(image.passes), bound_px=image.error_px if certified else None)
        if outline_factor(rung) not in outlines:
            outlines[outline_factor(rung)] = outline_of(image.pixels, true, distances)
        if _shows_shading(rung):
            shown.setdefault(shading_factor(rung), image.pixels)
    # last, since it leaves nothing of a frame in the caches
    shadings = {name: shading_of(pixels, true) for name, pixels in shown.items()}
    return Measured(
        size=step.size,
        view=step.view,
        area_px=area,
        silhouette_edges=edges,
        rungs=rungs,
        outlines={name: (s.error, s.squares, s.boundary, s.wrong, s.distance_px) for name, s in outlines.items()},
        shadings={name: (s.squares, s.bytes, s.similarity, s.pixels) for name, s in shadings.items()},
    )


def is_whole(one: Measured, asset: MeshAsset) -> bool:
    """Whether it has all that the ladder takes from it, of rungs that there are."""
    known = dict(enumerate(asset.rungs.rungs))
    return one.rungs.keys() <= known.keys() and all(outline_factor(known[number]) in one.outlines for number in one.rungs)


def put_together(asset: MeshAsset, device: str, measured: list[Measured], views: int = VIEWS) -> Ladder:
    """The ladder of all steps. Rungs that one of them refused are not in it: they would be compared in other views than the rest."""
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
    """A picture on a rung, the second of two where the first finds nothing in the caches; None where the view refuses the rung."""
    request = RenderRequest(camera=camera, width=size, height=size, accuracy=explicit(asset.rungs, number))
    try:
        for _ in range(2 if warm else 1):
            image = render_frame(gpu, asset, request, true_times=True)
    except CapabilityError:
        return None
    assert image.planned is not None
    return image if image.planned.choice.number == number else None


def _turn(rung: Rung) -> tuple[int, ...]:
    """Where a rung stands in the order of drawing: what draws, then what it outlines."""
    hull, level = (-1 if number is None else number for number in (rung.hull, rung.level))
    return SOURCE_CODE[rung.source], hull, rung.halvings, ANTIALIAS_CODE[rung.antialias], level


def _shows_shading(rung: Rung) -> bool:
    """Whether pictures of this rung stand for the shading of all that share its factor."""
    return rung.hull is None or (rung.antialias is Antialias.COVERAGE and rung.level is None)


def _at_size(rung: Rung, number: int, size: int, measured: list[Measured]) -> RungAtSize | None:
    drawn = [one.rungs[number] for one in measured if number in one.rungs]
    if len(drawn) < len(measured):
        return None
    outlines = [OutlineSums(*one.outlines[outline_factor(rung)]) for one in measured]
    shadings = [ShadingSums(*one.shadings[shading_factor(rung)]) for one in measured if shading_factor(rung) in one.shadings]
    names = dict.fromkeys(name for one in drawn for name in one.passes)
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
