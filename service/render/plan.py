"""From a request to the passes it needs, as plain data; what is drawn how is decided here and nowhere else."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from schemas.conventions import F8
from schemas.errors import CapabilityError, InvalidRequestError
from schemas.render import Accuracy, Antialias, RenderRequest, ShadingMode, Source
from service.assets import MeshAsset
from service.camera import View
from service.silhouette.levels import LevelInView, choose_level

ALWAYS = frozenset({"background"})
DRAWN = frozenset({"clear", "read", "composite"})
"""What a picture needs as soon as the GL draws anything of it."""

SILHOUETTE: dict[Antialias, frozenset[str]] = {
    Antialias.NONE: frozenset({"edges", "loops", "stencil"}),
    Antialias.LINE: frozenset({"edges", "loops", "stencil", "segments", "outline", "interior"}),
    Antialias.COVERAGE: frozenset({"edges", "segments", "coverage"}),
}
"""Passes that make the exact outline, by rung."""

SURFACE: dict[tuple[Source, Antialias], frozenset[str]] = {
    (Source.CLIPPED, Antialias.NONE): frozenset({"surface"}) | DRAWN,
    (Source.CLIPPED, Antialias.LINE): frozenset({"surface", "rim"}) | DRAWN,
    (Source.CLIPPED, Antialias.COVERAGE): frozenset({"hull", "surface", "rim", "composite"}),
    (Source.ORIGINAL, Antialias.NONE): frozenset({"surface"}) | DRAWN,
    (Source.ORIGINAL, Antialias.COVERAGE): frozenset({"surface", "rim"}) | DRAWN,
    (Source.ORIGINAL, Antialias.MSAA): frozenset({"surface", "resolve"}) | DRAWN,
    (Source.ORIGINAL, Antialias.SSAA): frozenset({"surface", "resolve"}) | DRAWN,
}
"""Passes that colour it; the rungs there are, by source. The rim colours pixels that the outline touches but no surface
does. The clipped hull under an exact mask is drawn without the GL."""

CERTAIN = 1e-6
"""Normalised units by which an eye must be outside to count as outside."""

SAMPLE_GRID: dict[Antialias, int] = {Antialias.MSAA: 2, Antialias.SSAA: 4}
"""Samples a pixel has along each side, where it is not one."""

OUTLINE_ERROR_PX: dict[Antialias, float] = {
    Antialias.NONE: math.sqrt(0.5),
    Antialias.LINE: math.sqrt(0.5),
    Antialias.COVERAGE: 0.5 / 255.0,
    Antialias.MSAA: math.sqrt(0.3125 / 2.0),
    Antialias.SSAA: math.sqrt(0.5) / 4.0,
}
"""How far from the outline, pixels, a point can be and yet count as on its other side: the longest way to a sample (one in the
middle of the pixel; four on a square lattice of side sqrt(0.3125); a grid of 4 x 4), or the rounding of an area to a byte."""


@dataclass(frozen=True)
class Plan:
    """What one frame does. passes: names, in no order (`frame.FRAME` has the order). closed: back faces cannot be seen.
    smooth: the outline is that of the surface with interpolated normals.
    hull: number of the hull that is drawn, None for the mesh. halvings: how often the sides of its maps are halved.
    """

    source: Source
    antialias: Antialias
    mode: ShadingMode
    passes: frozenset[str]
    closed: bool
    smooth: bool = False
    hull: int | None = None
    halvings: int = 0

    @property
    def on_cpu(self) -> bool:
        """Whether the picture needs no GL at all: the exact mask alone, or over the hull (`bands`)."""
        return self.antialias is Antialias.COVERAGE and (self.source is Source.CLIPPED or self.mode is ShadingMode.MASK)

    @property
    def rung(self) -> str:
        """Its name for people: source/antialias, and /smooth."""
        return f"{self.source.value}/{self.antialias.value}" + ("/smooth" if self.smooth else "")

    @property
    def error_px(self) -> float | None:
        """How far the outline may be off the mesh's, pixels; None for a smooth one, which means to be off."""
        return None if self.smooth else OUTLINE_ERROR_PX[self.antialias]

    def level_for(self, view: View, asset: MeshAsset, max_error_px: float | None) -> LevelInView | None:
        """The level whose outline may stand for the mesh's; None when it must be the mesh's, or none is clipped to."""
        if max_error_px is None or self.smooth or self.source is not Source.CLIPPED:
            return None
        return choose_level(asset.levels, view, asset.corners, max_error_px - OUTLINE_ERROR_PX[self.antialias])

    @property
    def sample_grid(self) -> int:
        """Samples along each side of a pixel."""
        return SAMPLE_GRID.get(self.antialias, 1)


def plan_frame(request: RenderRequest, asset: MeshAsset, eye: F8) -> Plan:
    """The plan for a request seen from eye (4,) f8, normalised frame.

    Raises CapabilityError when the request insists on what this mesh or this eye does not allow, InvalidRequestError when
    its rung does not exist.
    """
    refusal = _why_not_clipped(asset, eye)
    source, antialias = _rung(request, refusal)
    smooth = request.accuracy.smooth
    if smooth:
        _check_smooth(request.accuracy, refusal)
    mode = request.shading.mode
    outlined = source is Source.CLIPPED or antialias is Antialias.COVERAGE
    passes = ALWAYS | (SILHOUETTE[antialias] if outlined else frozenset())
    if outlined and mode is ShadingMode.MASK:
        passes |= _bare_mask(antialias)
    else:
        passes |= SURFACE[source, antialias]
    if smooth:
        passes |= {"smooth"}
    closed = source is Source.CLIPPED or (asset.edges is not None and _is_outside_box(asset, eye))
    return Plan(source, antialias, mode, passes, closed, smooth, 0 if source is Source.CLIPPED else None)


def _check_smooth(accuracy: Accuracy, refusal: str | None) -> None:
    """A smooth outline is a coverage mask, and that takes the silhouette."""
    if accuracy.max_error_px is not None:
        message = "a smooth outline is meant to leave the mesh's, so no error can be asked of it"
        raise InvalidRequestError(message, field="accuracy.max_error_px")
    if accuracy.antialias not in (Antialias.COVERAGE, Antialias.AUTO):
        raise InvalidRequestError("only coverage has a smooth outline", field="accuracy.smooth")
    if refusal is not None:
        raise CapabilityError(refusal, field="accuracy.smooth")


def _bare_mask(antialias: Antialias) -> frozenset[str]:
    """Passes that lay the outline's alpha down without any surface; an exact mask needs no GL at all."""
    return frozenset({"composite"}) if antialias is Antialias.COVERAGE else DRAWN | {"interior"}


def _rung(request: RenderRequest, refusal: str | None) -> tuple[Source, Antialias]:
    antialias, source = request.accuracy.antialias, request.accuracy.source
    if antialias is Antialias.AUTO:
        antialias = Antialias.COVERAGE
    if source is Source.AUTO:
        source = Source.CLIPPED if refusal is None and (Source.CLIPPED, antialias) in SURFACE else Source.ORIGINAL
    if source is Source.CLIPPED:
        if (source, antialias) not in SURFACE:
            raise InvalidRequestError(f"{antialias.value} is a rung of the original only", field="accuracy.antialias")
        if refusal is not None:
            raise CapabilityError(refusal, field="accuracy.source")
        return source, antialias
    needs_outline = antialias is Antialias.COVERAGE and refusal is not None
    return source, Antialias.MSAA if antialias is Antialias.LINE or needs_outline else antialias


def _why_not_clipped(asset: MeshAsset, eye: F8) -> str | None:
    """Why the silhouette cannot clip this view; None when it can.

    Silhouette Clipping counts front-facing layers along each ray from its contours alone, which is right from outside the
    convex hull of what is drawn (section 6).
    """
    if not asset.clippable or asset.hull is None:
        return asset.clip.reason or "the mesh was not prepared for clipping"
    if not _is_outside_convex_hull(asset, eye):
        return "the eye is inside the convex hull of the mesh's hull, where a silhouette does not clip"
    return None


def _is_outside_convex_hull(asset: MeshAsset, eye: F8) -> bool:
    """Whether the eye is certainly outside the convex hull of the mesh's hull."""
    x, y, z, w = eye.tolist()
    if w == 0.0 or math.hypot(x, y, z) > asset.radius * (1.0 + CERTAIN):
        return True
    planes = asset.hulls[0].convex_planes
    return bool(np.any(planes[:, :3] @ eye[:3] + planes[:, 3] > CERTAIN))


def _is_outside_box(asset: MeshAsset, eye: F8) -> bool:
    """Whether the eye is certainly outside the mesh's bounding box."""
    return bool(eye[3] == 0.0 or np.any(eye[:3] < asset.corners[0] - CERTAIN) or np.any(eye[:3] > asset.corners[-1] + CERTAIN))
