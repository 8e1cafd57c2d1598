"""Which rung a view is drawn on: what a request asks for, against what the mesh has and what it is predicted to cost."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from schemas.conventions import F8
from schemas.errors import CapabilityError, InvalidRequestError
from schemas.render import Accuracy, Antialias, Source
from service.assets import MeshAsset
from service.camera import View
from service.costs import CostModel, ViewTerms
from service.kernels.choose_rung import ANY, choose_rung
from service.rungs import ANTIALIAS_CODE, CERTIFIED, CLIPPED, SOURCE_CODE, Rung, RungTable
from service.silhouette.levels import LevelInView, Scale, scale_of

CERTAIN = 1e-6
"""Normalised units by which an eye must be outside to count as outside."""
UNSEEN_PX = 0.5 / 255.0
"""What a level may add to the error though nothing was asked: no pixel's alpha changes by more than the rounding to a byte."""


@dataclass(frozen=True)
class Choice:
    """A rung for a view. number: its place in the mesh's table. level: in the view, None for the mesh's own outline.

    error_px: how far the outline may be off; bound: `certified` when that holds whatever the mesh and the driver, `measured` or
    `nominal` (of an ideal driver) otherwise. predicted_ms: of the frame. missed: what was asked and cannot be kept: `max_error_px`,
    `min_psnr_db`, `budget_ms`. chosen: whether there was a choice to make.
    """

    number: int
    rung: Rung
    level: LevelInView | None
    error_px: float
    bound: str
    predicted_ms: float
    missed: tuple[str, ...]
    chosen: bool


class Wanted(NamedTuple):
    """Codes as `choose_rung` takes them."""

    source: int
    antialias: int
    level: int
    hull: int
    halvings: int


def choose(accuracy: Accuracy, asset: MeshAsset, view: View, terms: ViewTerms, costs: CostModel) -> Choice:
    """The rung for a request's accuracy.

    Raises CapabilityError when the request insists on what this mesh or this eye does not allow, InvalidRequestError when its rung does
    not exist.
    """
    refusal = why_not_clipped(asset, view.eye)
    table, limited = asset.rungs, accuracy.max_error_px is not None or accuracy.budget_ms is not None
    wanted = _wanted(accuracy, asset, refusal, limited)
    free = accuracy.budget_ms is not None or accuracy.min_psnr_db is not None
    scale = scale_of(view, asset.corners)
    limits = (
        math.inf if accuracy.max_error_px is None else accuracy.max_error_px,
        math.inf if limited or accuracy.level is not None else UNSEEN_PX,
        math.inf if accuracy.budget_ms is None else accuracy.budget_ms,
        accuracy.min_psnr_db or 0.0,
    )
    size = table.nearest_size(math.sqrt(terms.image_px))
    mesh = costs.of(asset)
    number, error_px, ms = choose_rung(
        table.arrays, size, mesh.costs, mesh.scale, costs.terms(asset, terms), scale, wanted, _hulls(asset, view.eye, scale, refusal), free,
        limits,
    )  # fmt: skip
    if number < 0:
        raise CapabilityError("the eye is too near to this level for its error to be known", field="accuracy.level")
    return _choice(table, number, error_px, ms, size, accuracy, asset, scale, limited or free)


def _choice(  # noqa: PLR0913, PLR0917 - everything there is to say of it
    table: RungTable, number: int, error_px: float, ms: float, size: int, accuracy: Accuracy, asset: MeshAsset, scale: Scale, chosen: bool
) -> Choice:
    rung = table.rungs[number]
    level = None if rung.level is None else LevelInView(asset.levels[rung.level], scale.of(asset.levels[rung.level].bound))
    missed = []
    if accuracy.max_error_px is not None and error_px > accuracy.max_error_px:
        missed.append("max_error_px")
    if accuracy.min_psnr_db is not None and table.measured and table.psnr[number, size] < accuracy.min_psnr_db:
        missed.append("min_psnr_db")
    if accuracy.budget_ms is not None and ms > accuracy.budget_ms:
        missed.append("budget_ms")
    bound = "certified" if rung.antialias in CERTIFIED else "measured" if table.measured else "nominal"
    return Choice(number, rung, level, float(error_px), bound, float(ms), tuple(missed), chosen)


def _wanted(accuracy: Accuracy, asset: MeshAsset, refusal: str | None, limited: bool) -> Wanted:
    """What the request insists on, or would have if nothing is to be chosen."""
    source, antialias = accuracy.source, accuracy.antialias
    if source is Source.CLIPPED and antialias not in (*CLIPPED, Antialias.AUTO):
        raise InvalidRequestError(f"{antialias.value} is a rung of the original only", field="accuracy.antialias")
    if source is Source.CLIPPED and refusal is not None:
        raise CapabilityError(refusal, field="accuracy.source")
    if not limited and antialias is Antialias.AUTO:
        antialias = Antialias.COVERAGE
    named = accuracy.level is not None or accuracy.hull_faces is not None or accuracy.texels is not None
    clips = refusal is None and antialias in (*CLIPPED, Antialias.AUTO)
    if source is Source.AUTO and (named or not limited or not clips):
        source = Source.CLIPPED if clips else Source.ORIGINAL
    if source is Source.ORIGINAL and (antialias is Antialias.LINE or (antialias is Antialias.COVERAGE and refusal is not None)):
        antialias = Antialias.MSAA
    return Wanted(
        SOURCE_CODE.get(source, ANY), ANTIALIAS_CODE.get(antialias, ANY), _level(accuracy, asset, source), *_named_hull(accuracy, asset)
    )


def _level(accuracy: Accuracy, asset: MeshAsset, source: Source) -> int:
    if accuracy.level is None or source is Source.ORIGINAL:
        return ANY
    if accuracy.level >= len(asset.levels):
        message = f"the mesh has {len(asset.levels)} levels, numbered from 0; -1 is the mesh itself"
        raise InvalidRequestError(message, field="accuracy.level")
    return accuracy.level


def _named_hull(accuracy: Accuracy, asset: MeshAsset) -> tuple[int, int]:
    """(hull, halvings) that were asked for."""
    hulls, number = asset.rungs.hulls, ANY
    if not hulls:
        return ANY, ANY
    if accuracy.hull_faces is not None:
        asked = math.log(accuracy.hull_faces)
        number = min(range(len(hulls)), key=lambda k: abs(math.log(hulls[k].faces) - asked))
    if accuracy.texels is None:
        return number, ANY
    hull = hulls[max(number, 0)]
    return number, next((h for h in range(hull.most_halvings) if hull.texels[h] <= accuracy.texels), hull.most_halvings)


def _hulls(asset: MeshAsset, eye: F8, scale: Scale, refusal: str | None) -> tuple[np.ndarray, np.ndarray]:
    """(usable (h,) bool, least (h,) i4): hulls that clip for this eye, and halvings after which a texel still is less than a pixel."""
    hulls = asset.rungs.hulls
    usable, least = np.zeros(max(1, len(hulls)), np.bool_), np.zeros(max(1, len(hulls)), np.int32)
    if refusal is not None:
        return usable, least
    for number, hull in enumerate(hulls):
        usable[number] = number == 0 or _is_outside_convex_hull(asset, number, eye)
        if hull.density > scale.pixels > 0.0:
            least[number] = min(int(math.log2(hull.density / scale.pixels)), hull.most_halvings)
    return usable, least


def why_not_clipped(asset: MeshAsset, eye: F8) -> str | None:
    """Why the silhouette cannot clip this view; None when it can.

    Silhouette Clipping counts front-facing layers along each ray from its contours alone, which is right from outside the
    convex hull of what is drawn (section 6).
    """
    if not asset.clippable or asset.hull is None:
        return asset.clip.reason or "the mesh was not prepared for clipping"
    if not _is_outside_convex_hull(asset, 0, eye):
        return "the eye is inside the convex hull of the mesh's hull, where a silhouette does not clip"
    return None


def _is_outside_convex_hull(asset: MeshAsset, number: int, eye: F8) -> bool:
    """Whether the eye is certainly outside the convex hull of one of the mesh's hulls."""
    x, y, z, w = eye.tolist()
    if w == 0.0 or math.hypot(x, y, z) > asset.radius * (1.0 + CERTAIN):
        return True
    planes = asset.hulls[number].convex_planes
    return bool(np.any(planes[:, :3] @ eye[:3] + planes[:, 3] > CERTAIN))
