"""A plan told to people: which passes in which order, why each, and what each is predicted to cost."""

from __future__ import annotations

from schemas.plan import PlannedArea, PlannedPass, PlanReport
from schemas.render import Accuracy, Antialias, RenderRequest, ShadingMode, Source
from service.assets import MeshAsset
from service.camera import View, resolve_camera
from service.costs import CostModel
from service.render.choice import why_not_clipped
from service.render.frame import FRAME
from service.render.plan import Plan, plan_frame


def explain(request: RenderRequest, asset: MeshAsset, costs: CostModel) -> PlanReport:
    """The plan of a request, with its reasons. Raises what `plan_frame` and `resolve_camera` raise."""
    view = resolve_camera(request.camera, asset.frame, request.width, request.height, asset.radius)
    plan = plan_frame(request, asset, view, costs)
    choice, names = plan.choice, [step.name for step in FRAME if step.name in plan.passes]
    costs_ms = costs.pass_ms(asset, choice.number, names, plan.terms(view))
    others = [step.name for step in FRAME if step.name not in plan.passes]
    level = None if plan.level is None else len(plan.level.level.faces)
    return PlanReport(
        rung=plan.rung,
        chosen=asset.rungs.keys[choice.number],
        why=_why(request, asset, view, plan),
        considered=len(asset.rungs.rungs),
        level_faces=level,
        error_px=plan.error_px,
        bound=choice.bound,
        missed=list(choice.missed),
        device=costs.device,
        predicted_ms=round(_frame_ms(plan, costs_ms), 4),
        passes=[PlannedPass(name=name, why=_reason(name, plan, asset), predicted_ms=round(costs_ms[name], 4)) for name in names],
        left_out=[PlannedPass(name=name, why=_absence(name, plan)) for name in others],
        area=PlannedArea(x=plan.area.x, y=plan.area.y, width=plan.area.width, height=plan.area.height),
    )


def _frame_ms(plan: Plan, of_passes: dict[str, float]) -> float:
    """The whole frame's; the sum of its passes where it is not what the rung always does."""
    whole = plan.area.width and plan.mode is not ShadingMode.MASK and not plan.smooth and plan.lines is None
    return plan.choice.predicted_ms if whole else sum(of_passes.values())


def _why(request: RenderRequest, asset: MeshAsset, view: View, plan: Plan) -> str:
    """Why this rung."""
    accuracy = request.accuracy
    if not plan.area.width:
        return "nothing of the mesh is in view"
    if plan.lines is not None:
        return "lines are drawn on the original mesh"
    if accuracy.budget_ms is not None or accuracy.max_error_px is not None:
        return _why_chosen(accuracy, plan.choice.missed)
    if plan.source is Source.CLIPPED:
        return "clipping draws the mesh's exact outline, and a coarse hull inside it"
    if accuracy.source is Source.ORIGINAL:
        return "the original was asked for"
    return why_not_clipped(asset, view.eye) or f"{plan.antialias.value} is a rung of the original"


def _why_chosen(accuracy: Accuracy, missed: tuple[str, ...]) -> str:
    """Why this rung, where there was a bound or a budget."""
    bound = f"{accuracy.max_error_px:g} px" if accuracy.max_error_px is not None else None
    if "max_error_px" in missed:
        return f"no rung keeps {bound}: this is the most accurate"
    if accuracy.budget_ms is None:
        return f"predicted to be the fastest whose outline is within {bound}"
    kept, budget = "" if bound is None else f" of those that keep {bound}", f"{accuracy.budget_ms:g} ms"
    if "budget_ms" in missed:
        return f"no rung{kept} is predicted to fit into {budget}: this is the fastest"
    return f"the most accurate{kept} that is predicted to fit into {budget}"


_LINE_REASONS = {
    "first_layer": "which faces are nearest is seen, since facing does not tell",
    "line_faces": "the silhouette is where faces behind adjoin the nearest layer",
    "vector_lines": "strokes go along the exact visible lines of this view",
    "line_strokes": "lines have a width in pixels",
    "charcoal": "faces seen nearly edge-on were asked to be fatter",
    "lines_back": "back faces are drawn as the silhouette's lines",
    "line_edges": "edges were asked for whatever the view",
    "edge_mesh": "edges that are lines in this view are drawn as such",
    "strokes": "strokes are drawn over what is known to be behind them",
}


def _reason(name: str, plan: Plan, asset: MeshAsset) -> str:
    """Why a pass is in a plan."""
    outline = "the mesh" if plan.level is None else f"a level of {len(plan.level.level.faces)} faces, within the error asked for"
    surface = "the mesh" if plan.hull is None else f"the hull of {asset.hulls[plan.hull].faces} faces"
    bare = plan.mode is ShadingMode.MASK and "surface" not in plan.passes
    reasons = {
        "background": "every picture begins with it",
        "edges": f"the outline is the silhouette of {outline}",
        "loops": "the stencil counts closed loops",
        "segments": "the outline is needed in pixels",
        "smooth": "the outline is that of the surface with interpolated normals",
        "hull": f"{surface} is drawn by the CPU",
        "deform": "the mesh has other positions than it was loaded with",
        "clear": "the GL draws into an empty target",
        "stencil": "the winding number of the silhouette says what is inside",
        "surface": f"{surface} gives the colour",
        "rim": "the outline touches pixels whose centres the surface does not reach",
        "outline": "lines along the silhouette smooth its alpha",
        "interior": "alpha inside is the stencil's",
        "coverage": "alpha is the area of the silhouette in each pixel",
        "resolve": f"{plan.sample_grid**2} samples become one pixel" if plan.sample_grid > 1 else "what was blended becomes straight alpha",
        "read": "the GL's pixels are needed in memory",
        "composite": "one flat colour under the mask" if bare else "colour and alpha become one picture",
    }
    return {**reasons, **_LINE_REASONS}[name]


def _absence(name: str, plan: Plan) -> str:
    """Why a pass is not in a plan."""
    if not plan.area.width:
        return "nothing is in view"
    if name in ("surface", "rim", "hull") and plan.mode is ShadingMode.MASK:
        return "only the mask was asked for"
    if name in _LINE_REASONS:
        return "no lines of this kind were asked for" if plan.lines else "no lines were asked for"
    outlined = "edges" in plan.passes
    if name in ("edges", "loops", "segments", "stencil", "outline", "interior", "coverage") and not outlined:
        return "the GL's own samples make the outline"
    if name in ("clear", "read") and plan.on_cpu:
        return "nothing is drawn by the GL"
    reasons = {
        "smooth": "the mesh's own outline was asked for",
        "hull": "the GL draws the surface",
        "deform": "the mesh is drawn as it was loaded",
        "resolve": "there is one sample a pixel",
        "surface": "nothing of it is shown, and strokes are known to be in sight without it",
        "rim": "pixels show what is at their centres",
        "composite": "the GL's pixels are the picture",
    }
    exact = (
        "alpha is summed exactly"
        if plan.antialias is Antialias.COVERAGE
        else "alpha is not smoothed"
        if plan.antialias is Antialias.NONE
        else "alpha comes from lines"
    )
    return reasons.get(name, exact)
