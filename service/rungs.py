"""The rungs of a mesh: every way in which it can be drawn, and what is known of each before a view is."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, cached_property

import numpy as np

from schemas.conventions import F8, I4
from schemas.ladder import Ladder, MeasuredRung, RungKey
from schemas.render import Antialias, Source

OUTLINE_ERROR_PX: dict[Antialias, float] = {
    Antialias.NONE: math.sqrt(0.5),
    Antialias.LINE: math.sqrt(0.5),
    Antialias.COVERAGE: 0.5 / 255.0,
    Antialias.MSAA: math.sqrt(0.3125 / 2.0),
    Antialias.SSAA: math.sqrt(0.5) / 4.0,
}
"""How far from the outline, pixels, a point can be and yet count as on its other side: the longest way to a sample (one in the
middle of the pixel; four on a square lattice of side sqrt(0.3125); a grid of 4 x 4), or the rounding of an area to a byte."""

CERTIFIED = frozenset({Antialias.NONE, Antialias.COVERAGE, Antialias.SSAA})
"""Whose bound holds whatever the driver. Where the samples of the others are is for the driver to say: they are measured."""

ALWAYS = frozenset({"background"})
DRAWN = frozenset({"clear", "read", "composite"})
"""What a picture needs as soon as the GL draws anything of it."""

SILHOUETTE: dict[Antialias, frozenset[str]] = {
    Antialias.NONE: frozenset({"edges", "loops", "stencil"}),
    Antialias.LINE: frozenset({"edges", "loops", "stencil", "segments", "outline", "interior"}),
    Antialias.COVERAGE: frozenset({"edges", "segments", "coverage"}),
}
"""Passes that make the exact outline."""

SURFACE: dict[tuple[Source, Antialias], frozenset[str]] = {
    (Source.CLIPPED, Antialias.NONE): frozenset({"surface"}) | DRAWN,
    (Source.CLIPPED, Antialias.LINE): frozenset({"surface", "rim"}) | DRAWN,
    (Source.CLIPPED, Antialias.COVERAGE): frozenset({"hull", "surface", "rim", "composite"}),
    (Source.ORIGINAL, Antialias.NONE): frozenset({"surface"}) | DRAWN,
    (Source.ORIGINAL, Antialias.COVERAGE): frozenset({"surface", "rim"}) | DRAWN,
    (Source.ORIGINAL, Antialias.MSAA): frozenset({"surface", "resolve"}) | DRAWN,
    (Source.ORIGINAL, Antialias.SSAA): frozenset({"surface", "resolve"}) | DRAWN,
}
"""Passes that colour it, for what there is. The rim colours pixels that the outline touches but no surface does. The clipped hull under
an exact mask is drawn without the GL."""

UNMASKED: tuple[Antialias, ...] = (Antialias.NONE, Antialias.MSAA, Antialias.SSAA)
CLIPPED: tuple[Antialias, ...] = (Antialias.NONE, Antialias.LINE, Antialias.COVERAGE)
MOST_HALVINGS = 2
LEAST_SIDE = 3
"""Texels along a leg of a hull face: maps are not halved below."""

SOURCES: tuple[Source, ...] = (Source.ORIGINAL, Source.CLIPPED)
ANTIALIASES: tuple[Antialias, ...] = (*UNMASKED, Antialias.LINE, Antialias.COVERAGE)
"""Kernels know both by their places here."""
SOURCE_CODE = {source: code for code, source in enumerate(SOURCES)}
ANTIALIAS_CODE = {antialias: code for code, antialias in enumerate(ANTIALIASES)}


@dataclass(frozen=True)
class Rung:
    """A way of drawing. level: number of the level that the outline is taken from, None for the mesh. hull: number of the hull that is
    drawn, None for the mesh. halvings: how often the sides of its maps are halved.
    """

    source: Source
    antialias: Antialias
    level: int | None = None
    hull: int | None = None
    halvings: int = 0


def is_outlined(source: Source, antialias: Antialias) -> bool:
    """Whether the exact silhouette makes the outline."""
    return source is Source.CLIPPED or antialias is Antialias.COVERAGE


@cache
def passes_of(source: Source, antialias: Antialias) -> frozenset[str]:
    """The passes of a shaded picture."""
    outline = SILHOUETTE[antialias] if is_outlined(source, antialias) else frozenset()
    return ALWAYS | outline | SURFACE[source, antialias]


@dataclass(frozen=True)
class HullFacts:
    """What rungs depend on of a hull. texels: longest side of its maps after each number of halvings, 0 for no maps. density: texels of
    the full maps along a normalised unit of its larger faces.
    """

    faces: int
    texels: tuple[int, ...]
    density: float

    @property
    def most_halvings(self) -> int:
        """How often its maps can be halved."""
        return len(self.texels) - 1


@dataclass(frozen=True)
class RungTable:
    """All rungs of a mesh, as arrays over them (n,) and over the measured sizes (s,), for the kernel that chooses.

    source, antialias, level (-1 for the mesh), hull (-1), halvings: i4. beyond: (n,) f8 bound of the level, normalised units.
    alone_px: (n, s + 1) f8 error of the antialiasing alone, pixels, last the one that needs no measuring. psnr: (n, s + 1) f8 decibels
    of shading, last a guess that orders what was not measured. certified: (n,) bool, of alone_px. measured: whether there is a ladder.
    """

    rungs: tuple[Rung, ...]
    keys: tuple[RungKey, ...]
    hulls: tuple[HullFacts, ...]
    level_faces: tuple[int, ...]
    source: I4
    antialias: I4
    level: I4
    hull: I4
    halvings: I4
    beyond: F8
    alone_px: F8
    psnr: F8
    sizes: tuple[int, ...]
    measured: bool

    @cached_property
    def arrays(self) -> tuple[I4, I4, I4, I4, I4, F8, F8, F8]:
        """As `choose_rung` takes them."""
        return self.source, self.antialias, self.level, self.hull, self.halvings, self.beyond, self.alone_px, self.psnr

    def nearest_size(self, side: float) -> int:
        """Number of the measured size that is nearest to a picture's side, pixels; the number after the last when none was measured."""
        if not self.measured:
            return len(self.sizes)
        return min(range(len(self.sizes)), key=lambda k: abs(math.log(self.sizes[k] / max(side, 1.0))))


def rung_table(clippable: bool, levels: Sequence[tuple[int, float]], hulls: Sequence[HullFacts], ladder: Ladder | None) -> RungTable:
    """The rungs of a mesh. levels: (faces, bound) of each, finest first."""
    rungs = _all_rungs(clippable, len(levels), hulls)
    keys = tuple(_key(rung, hulls) for rung in rungs)
    found = {} if ladder is None else {key_of(rung): rung for rung in ladder.rungs}
    sizes = () if ladder is None else tuple(facts.size for facts in ladder.facts)
    code = np.array(
        [(SOURCE_CODE[r.source], ANTIALIAS_CODE[r.antialias], _or(r.level), _or(r.hull), r.halvings) for r in rungs], np.int32
    ).reshape(-1, 5)
    known = [found.get(key) for key in keys]
    alone = [found.get(key.model_copy(update={"level": None})) for key in keys]
    return RungTable(
        rungs=rungs,
        keys=keys,
        hulls=tuple(hulls),
        level_faces=tuple(faces for faces, _ in levels),
        source=np.ascontiguousarray(code[:, 0]),
        antialias=np.ascontiguousarray(code[:, 1]),
        level=np.ascontiguousarray(code[:, 2]),
        hull=np.ascontiguousarray(code[:, 3]),
        halvings=np.ascontiguousarray(code[:, 4]),
        beyond=np.array([0.0 if r.level is None else levels[r.level][1] for r in rungs]),
        alone_px=np.array([_alone_px(rung, mine, len(sizes)) for rung, mine in zip(rungs, alone, strict=True)]),
        psnr=np.array([_psnr(rung, mine, hulls, len(sizes)) for rung, mine in zip(rungs, known, strict=True)]),
        sizes=sizes,
        measured=ladder is not None,
    )


def key_of(rung: RungKey) -> RungKey:
    """The bare key of a rung that has more to it."""
    return RungKey(**rung.model_dump(include=set(RungKey.model_fields)))


def _all_rungs(clippable: bool, levels: int, hulls: Sequence[HullFacts]) -> tuple[Rung, ...]:
    made = [Rung(Source.ORIGINAL, antialias) for antialias in UNMASKED]
    if not clippable:
        return tuple(made)
    made.append(Rung(Source.ORIGINAL, Antialias.COVERAGE))
    for number, hull in enumerate(hulls):
        for halvings in range(hull.most_halvings + 1):
            for level in (None, *range(levels)):
                made += [Rung(Source.CLIPPED, antialias, level, number, halvings) for antialias in CLIPPED]
    return tuple(made)


def _key(rung: Rung, hulls: Sequence[HullFacts]) -> RungKey:
    hull = None if rung.hull is None else hulls[rung.hull]
    return RungKey(
        source=rung.source,
        antialias=rung.antialias,
        level=rung.level,
        hull_faces=None if hull is None else hull.faces,
        texels=None if hull is None else hull.texels[rung.halvings],
    )


def _or(number: int | None) -> int:
    return -1 if number is None else number


def _alone_px(rung: Rung, measured: MeasuredRung | None, sizes: int) -> list[float]:
    """The bound of the antialiasing where it is certified, what was measured of it otherwise."""
    bound = OUTLINE_ERROR_PX[rung.antialias]
    if measured is None or rung.antialias in CERTIFIED:
        return [bound] * (sizes + 1)
    return [*(at.outline.distance_px for at in measured.sizes), bound]


def _psnr(rung: Rung, measured: MeasuredRung | None, hulls: Sequence[HullFacts], sizes: int) -> list[float]:
    """Measured decibels; unmeasured, a guess that puts the mesh itself before hulls, and hulls in the order of their faces and texels."""
    guess = 50.0
    if rung.hull is not None:
        hull = hulls[rung.hull]
        guess = 10.0 + math.log2(hull.faces) + 0.5 * math.log2(max(1, hull.texels[0])) - rung.halvings
    return [guess] * (sizes + 1) if measured is None else [*(at.shading.psnr_db for at in measured.sizes), guess]
