"""From a scene to the layers it is made of, as plain data: what is drawn alone, what together and why, in which order."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from schemas.conventions import Frame
from schemas.errors import CapabilityError, InvalidRequestError
from schemas.lines import LineMethod, Lines
from schemas.render import Accuracy, Antialias, Fill, RenderRequest, Source
from schemas.scene import SceneRequest, matrix_of
from service.assets import MeshAsset
from service.camera import View, resolve_camera
from service.kernels.screen_bounds import NOTHING, screen_bounds
from service.render.line_plan import lined, lines_asked, reach_px, styles_of
from service.render.plan import plan_frame
from service.scene.order import Group, Placed, sort_groups
from service.scene.place import own_view, place, sphere_around, view_of
from service.scene.stretch import in_shape
from service.tile import BORDER

TANGLED, CYCLE, ASKED = "their convex hulls meet", "they hide each other in a circle", "the originals were asked for"
LINED = "lines need a common depth"
"""Why objects are drawn together."""

METHODS = frozenset({LineMethod.EDGE_MESH, LineMethod.WIREFRAME, LineMethod.TRANSLATED, LineMethod.FATTENED})
"""Ways to draw lines that look at one depth buffer for what hides them, whosever surfaces are in it."""
NO_LINES = Lines(silhouette=None, boundary=None)
"""Those of an object without any among others that have some: it may be white, or hide them and be nothing else."""

UNMASKED = frozenset({Antialias.NONE, Antialias.MSAA, Antialias.SSAA})
"""Rungs on which originals have samples and no exact outline: drawn together, with depth, they need no order and have no seams."""


@dataclass(frozen=True)
class Part:
    """An object of a layer. index: its place in the scene's request. request, view: as `render_view` takes them."""

    index: int
    asset: MeshAsset
    request: RenderRequest
    view: View


@dataclass(frozen=True)
class Layer:
    """What is drawn at one place of the order: one object, or several in a common depth buffer, `why` saying why."""

    parts: tuple[Part, ...]
    why: str | None


@dataclass(frozen=True)
class ScenePlan:
    """One picture. layers: the farthest first. outside: places in the request of objects that are not in the picture."""

    width: int
    height: int
    background: str
    layers: tuple[Layer, ...]
    outside: tuple[int, ...]


def plan_scene(request: SceneRequest, assets: Sequence[MeshAsset]) -> ScenePlan:
    """The plan for a request whose object i shows assets[i]. No GL takes part.

    Raises InvalidRequestError and CapabilityError, naming the field; the error of an object also has its place in `where`.
    """
    size = (request.width, request.height)
    _check_lines(request)
    standing = [
        place(asset, matrix_of(o.transform), f"objects[{i}].transform")
        for i, (o, asset) in enumerate(zip(request.objects, assets, strict=True))
    ]
    around = sphere_around(standing)
    camera = resolve_camera(request.camera, around, *size)
    seen, outside = [], []
    for i, (asset, placement) in enumerate(zip(assets, standing, strict=True)):
        try:
            view = own_view(asset, placement, request.camera, size, around)
        except InvalidRequestError as error:  # the camera is right for the scene: it is the object that is far too small in it
            field = f"objects[{i}].transform"
            raise InvalidRequestError(f"{field} is too extreme for this scene", field=field) from error
        if _is_outside(asset, view, request.lines_of(i)):
            outside.append(i)
        else:
            seen.append(Placed(i, asset, placement, view))
    return ScenePlan(*size, request.background, tuple(_layers(request, seen, camera, around)), tuple(outside))


def _layers(request: SceneRequest, seen: list[Placed], camera: View, around: Frame) -> list[Layer]:
    if request.has_lines:
        return _with_lines(request, seen, camera, around)
    if request.accuracy.source is Source.ORIGINAL and request.accuracy.antialias in UNMASKED and len(seen) > 1:
        return [_together(request, seen, around, ASKED, _sampled(request.accuracy))]
    layers, each = [], _share_of(request.accuracy, len(seen))
    for group in sort_groups(seen, camera.eye, around):
        members = [seen[m] for m in group.members]
        if len(members) == 1:
            layers.append(_alone(request, members[0], each))
        else:
            _refuse_clipped(request.accuracy, members, _reason(group))
            layers.append(_together(request, members, around, _reason(group), _sampled(request.accuracy)))
    return layers


def _with_lines(request: SceneRequest, seen: list[Placed], camera: View, around: Frame) -> list[Layer]:
    """All at one place, the farthest first if that can be seen: where lines of two objects meet, the nearer one's are over the other's."""
    accuracy = lined(request.accuracy)
    shaped = [_shaped(request, placed, around) for placed in seen]
    if len(shaped) < 2:
        return [_alone(request, placed, accuracy) for placed in shaped]
    if _order_shows([request.lines_of(placed.index) for placed in seen]):
        shaped = [shaped[member] for group in sort_groups(seen, camera.eye, around) for member in group.members]
    return [_together(request, shaped, around, LINED, accuracy)]


def _order_shows(lines: Sequence[Lines | None]) -> bool:
    """Whether it can be seen which of two lines is over the other."""
    looks = {(style.color, style.opacity) for one in lines if one is not None for style in styles_of(one)}
    return len(looks) > 1 or any(opacity < 1.0 for _, opacity in looks)


def _shaped(request: SceneRequest, placed: Placed, around: Frame) -> Placed:
    """The object with its mesh in the shape that the placement gives it."""
    asset, placement = in_shape(placed.asset, placed.placement)
    if asset is placed.asset:
        return placed
    view = own_view(asset, placement, request.camera, (request.width, request.height), around)
    return replace(placed, asset=asset, placement=placement, view=view)


def _share_of(accuracy: Accuracy, objects: int) -> Accuracy:
    """An object's part of a budget that is for all of them; a bound is for each."""
    if accuracy.budget_ms is None or objects < 2:
        return accuracy
    return accuracy.model_copy(update={"budget_ms": accuracy.budget_ms / objects})


def _alone(request: SceneRequest, placed: Placed, accuracy: Accuracy) -> Layer:
    part = Part(placed.index, placed.asset, _of_object(request, placed.index, accuracy), placed.view)
    _check(part)
    return Layer((part,), None)


def _together(request: SceneRequest, members: Sequence[Placed], around: Frame, why: str, accuracy: Accuracy) -> Layer:
    """Originals in one depth range: their views come from one camera for all of them."""
    frame = sphere_around([placed.placement for placed in members])
    base = resolve_camera(request.camera, frame, request.width, request.height, around=around)
    parts = [
        Part(placed.index, placed.asset, _of_object(request, placed.index, accuracy), view_of(placed.placement, base, frame, around))
        for placed in members
    ]
    return Layer(tuple(parts), why)


def _refuse_clipped(accuracy: Accuracy, members: Sequence[Placed], why: str) -> None:
    if accuracy.source is Source.CLIPPED:
        numbers = ", ".join(str(placed.index) for placed in members)
        raise CapabilityError(f"objects {numbers} can only be drawn together, from their originals: {why}", field="accuracy.source")


def _sampled(accuracy: Accuracy) -> Accuracy:
    """What drawing several together leaves of an accuracy."""
    return Accuracy(source=Source.ORIGINAL, antialias=accuracy.antialias if accuracy.antialias in UNMASKED else Antialias.MSAA)


def _reason(group: Group) -> str:
    return TANGLED if group.tangled else CYCLE


def _of_object(request: SceneRequest, index: int, accuracy: Accuracy) -> RenderRequest:
    """One object's picture on a transparent ground; its camera is resolved apart."""
    shading, lines = request.shading_of(index), request.lines_of(index)
    if lines is None and shading.fill is not Fill.SHADED and request.has_lines:
        lines = NO_LINES
    return RenderRequest(width=request.width, height=request.height, shading=shading, accuracy=accuracy, lines=lines)


def _check_lines(request: SceneRequest) -> None:
    """Refuse lines that make no sense, and those that only single meshes have."""
    for index, item in enumerate(request.objects):
        try:
            _check_method(lines_asked(_of_object(request, index, request.accuracy)))
        except InvalidRequestError as error:
            part, name = error.where["field"].split(".")[:2]
            own = getattr(item, part)
            said = own is not None and name in own.model_fields_set
            field = f"objects[{index}].{error.where['field']}" if said else error.where["field"]
            raise InvalidRequestError(f"objects[{index}]: {error.message}", field=field, object=index) from error


def _check_method(lines: Lines | None) -> None:
    if lines is not None and lines.method not in METHODS:
        raise InvalidRequestError(f"lines by {lines.method.value} are of single meshes, not scenes", field="lines.method")


def _check(part: Part) -> None:
    """Refuse now what the drawing of this object would refuse."""
    try:
        plan_frame(part.request, part.asset, part.view)
    except InvalidRequestError as error:
        message = f"objects[{part.index}]: {error.message}" if isinstance(error, CapabilityError) else error.message
        raise type(error)(message, field=error.where["field"], object=part.index) from error


def _is_outside(asset: MeshAsset, view: View, lines: Lines | None) -> bool:
    """Whether nothing of an object can be in the picture, nor of its lines beside it."""
    reach = 0 if lines is None else reach_px(lines, view)
    points = asset.corners if asset.hull is None else np.asarray(asset.hull["positions"])
    return bool(screen_bounds(view.matrix, points, view.width, view.height, BORDER + reach)[0] == NOTHING)
