"""From a request to the passes it needs, as plain data; what is drawn how is decided here and nowhere else."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from schemas.conventions import F8
from schemas.errors import CapabilityError, InvalidRequestError
from schemas.lines import LineMethod, Lines
from schemas.render import Accuracy, Antialias, Fill, RenderRequest, ShadingMode, Source
from service.assets import MeshAsset
from service.camera import View
from service.costs import GRID, NOMINAL, CostModel, ViewTerms
from service.kernels.screen_bounds import SOME, UNKNOWN, screen_bounds
from service.render.choice import CERTAIN, Choice, choose, why_not_clipped
from service.render.deep import is_too_far
from service.render.line_plan import is_deep, is_translucent, line_passes, lined, lines_asked, reach_px
from service.rungs import ALWAYS, DRAWN, SILHOUETTE, is_outlined, passes_of
from service.silhouette.levels import LevelInView
from service.tile import BORDER, Tile


@dataclass(frozen=True)
class Plan:
    """What one frame does. choice: the rung, and why. passes: names, in no order (`frame.FRAME` has the order); only the background
    when nothing is in view. closed: back faces cannot be seen. smooth: the outline is that of the surface with interpolated normals.
    area: the part of the image that can have anything of the mesh in it. lines: that are drawn over it, if any.
    deep: depth is in floats, and reversed (`service.render.deep`). marked: lines are blended there, every sample once.
    """

    choice: Choice
    mode: ShadingMode
    passes: frozenset[str]
    closed: bool
    area: Tile
    smooth: bool = False
    lines: Lines | None = None
    deep: bool = False
    marked: bool = False

    @property
    def source(self) -> Source:
        """What is drawn."""
        return self.choice.rung.source

    @property
    def antialias(self) -> Antialias:
        """How the outline is smoothed."""
        return self.choice.rung.antialias

    @property
    def hull(self) -> int | None:
        """Number of the hull that is drawn, None for the mesh."""
        return self.choice.rung.hull

    @property
    def halvings(self) -> int:
        """How often the sides of its maps are halved."""
        return self.choice.rung.halvings

    @property
    def level(self) -> LevelInView | None:
        """What the outline is taken from, None for the mesh."""
        return self.choice.level

    def terms(self, view: View) -> ViewTerms:
        """What the view adds to its cost."""
        return ViewTerms(self.area.pixels, view.width * view.height, 0.0 if self.level is None else self.level.error_px)

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
        """How far the outline may be off the mesh's, pixels; None for a smooth one or one of lines, which mean to be off."""
        return None if self.smooth or self.lines is not None else self.choice.error_px

    @property
    def sample_grid(self) -> int:
        """Samples along each side of a pixel."""
        return GRID.get(self.antialias, 1)


OF_THE_MESH = (ShadingMode.GOOCH, ShadingMode.FLAT, ShadingMode.DEPTH, ShadingMode.MATCAP)
"""Shading that hulls have not."""
_NOMINAL = CostModel("nominal", NOMINAL)


def plan_frame(request: RenderRequest, asset: MeshAsset, view: View, costs: CostModel | None = None) -> Plan:
    """The plan for a request in a view. costs: of the device that draws; nominal ones without.

    Raises CapabilityError when the request insists on what this mesh or this eye does not allow, InvalidRequestError when
    its rung does not exist.
    """
    accuracy, mode = request.accuracy, request.shading.mode
    lines = lines_asked(request)
    if lines is not None:
        accuracy = lined(accuracy)
    elif mode in OF_THE_MESH:
        accuracy = _of_the_mesh(accuracy, mode)
    if accuracy.smooth:
        accuracy = _smoothed(accuracy, asset, view.eye)
    area = visible_area(asset, view, 0 if lines is None else reach_px(lines, view))
    choice = choose(accuracy, asset, view, ViewTerms(area.pixels, view.width * view.height), costs or _NOMINAL)
    source, antialias = choice.rung.source, choice.rung.antialias
    if not area.width:
        passes = ALWAYS
    elif mode is ShadingMode.MASK and is_outlined(source, antialias):
        passes = _mask_passes(antialias)
    else:
        passes = passes_of(source, antialias)
    if accuracy.smooth and area.width:
        passes |= {"smooth"}
    closed = source is Source.CLIPPED or (asset.encloses and _is_outside_box(asset, view.eye))
    if asset.base is not None and area.width:
        passes |= {"deform"}
    if lines is not None:
        closed = closed and lines.orientation == "trusted"
        passes |= line_passes(lines, asset, closed) if area.width else frozenset()
        if lines.method is LineMethod.STROKES and request.shading.fill is Fill.NONE:
            passes -= {"surface"}  # which hides nothing that has not been left out already
    deep = is_deep(passes)
    marked = deep and lines is not None and is_translucent(lines)
    return Plan(choice, mode, passes, closed, area, accuracy.smooth, lines, deep, marked)


def shared_plan(plans: Sequence[Plan], view: View) -> Plan:
    """That of the target that meshes share: what one of them needs of it, it has. view: of any of them.

    Depth is in floats too where whole numbers could not tell how far lines are before what they hide: meshes may be near and far.
    """
    passes = frozenset[str]().union(*(plan.passes for plan in plans))
    deep = any(plan.deep for plan in plans) or ("edge_mesh" in passes and is_too_far(view))
    marked = any(plan.marked for plan in plans)
    return replace(plans[0], passes=passes, deep=deep, marked=marked)


def drawn_there(plan: Plan, shared: Plan) -> Plan:
    """A mesh's plan in a target that it shares: depth is as deep as any needs it, and samples are averaged where any are."""
    return replace(plan, passes=plan.passes | (shared.passes & {"resolve"}), deep=shared.deep)


def visible_area(asset: MeshAsset, view: View, reach: int = 0) -> Tile:
    """The part of the image that can have anything of the mesh in it; empty (no width) when none can. reach: pixels by which what is
    drawn may leave the mesh.

    Whatever is drawn, the mesh is inside its hull, whose vertices bound it better than a box does.
    """
    points = asset.corners if asset.hull is None else asset.hull["positions"]
    kind, x0, y0, x1, y1 = screen_bounds(view.matrix, points, view.width, view.height, BORDER + reach)
    whole = Tile(0, 0, view.width, view.height)
    if kind == SOME:
        return whole.within((x0, y0), (x1, y1), BORDER + reach)
    return whole if kind == UNKNOWN else Tile(0, 0, 0, 0)


def _of_the_mesh(accuracy: Accuracy, mode: ShadingMode) -> Accuracy:
    """What shading that only the mesh has leaves of an accuracy."""
    if accuracy.source is Source.CLIPPED:
        raise InvalidRequestError(f"{mode.value} shades the original mesh: a clipped hull has none", field="accuracy.source")
    return accuracy.model_copy(update={"source": Source.ORIGINAL})


def _smoothed(accuracy: Accuracy, asset: MeshAsset, eye: F8) -> Accuracy:
    """What a smooth outline asks for: it is a coverage mask, and that takes the silhouette of the mesh itself."""
    for field in ("max_error_px", "budget_ms"):
        if getattr(accuracy, field) is not None:
            raise InvalidRequestError(f"a smooth outline is meant to leave the mesh's: no {field} goes with it", field=f"accuracy.{field}")
    if accuracy.antialias not in (Antialias.COVERAGE, Antialias.AUTO):
        raise InvalidRequestError("only coverage has a smooth outline", field="accuracy.smooth")
    if (refusal := why_not_clipped(asset, eye)) is not None:
        raise CapabilityError(refusal, field="accuracy.smooth")
    return accuracy.model_copy(update={"antialias": Antialias.COVERAGE, "level": -1})


def _mask_passes(antialias: Antialias) -> frozenset[str]:
    """Passes that lay the outline's alpha down without any surface; an exact mask needs no GL at all."""
    bare = frozenset({"composite"}) if antialias is Antialias.COVERAGE else DRAWN | {"interior"}
    return ALWAYS | SILHOUETTE[antialias] | bare


def _is_outside_box(asset: MeshAsset, eye: F8) -> bool:
    """Whether the eye is certainly outside the mesh's bounding box."""
    return bool(eye[3] == 0.0 or np.any(eye[:3] < asset.corners[0] - CERTAIN) or np.any(eye[:3] > asset.corners[-1] + CERTAIN))
