"""From a scene to the layers it is made of, as plain data: what is drawn alone, what together and why, in which order."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from schemas.conventions import Frame
from schemas.errors import CapabilityError, InvalidRequestError
from schemas.render import Accuracy, Antialias, RenderRequest, Source
from schemas.scene import SceneRequest, matrix_of
from service.assets import MeshAsset
from service.camera import View, resolve_camera
from service.kernels.screen_bounds import NOTHING, screen_bounds
from service.render.plan import OF_THE_MESH, plan_frame
from service.scene.order import Group, Placed, sort_groups
from service.scene.place import own_view, place, sphere_around, view_of
from service.tile import BORDER

TANGLED, CYCLE, ASKED = "their convex hulls meet", "they hide each other in a circle", "the originals were asked for"
"""Why objects are drawn together."""

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
        if _is_outside(asset, view):
            outside.append(i)
        else:
            seen.append(Placed(i, asset, placement, view))
    return ScenePlan(*size, request.background, tuple(_layers(request, seen, camera, around)), tuple(outside))


def _layers(request: SceneRequest, seen: list[Placed], camera: View, around: Frame) -> list[Layer]:
    if request.accuracy.source is Source.ORIGINAL and request.accuracy.antialias in UNMASKED and len(seen) > 1:
        return [_together(request, seen, around, ASKED)]
    layers, each = [], _share_of(request.accuracy, len(seen))
    for group in sort_groups(seen, camera.eye, around):
        members = [seen[m] for m in group.members]
        layers.append(_alone(request, members[0], each) if len(members) == 1 else _together(request, members, around, _reason(group)))
    return layers


def _share_of(accuracy: Accuracy, objects: int) -> Accuracy:
    """An object's part of a budget that is for all of them; a bound is for each."""
    if accuracy.budget_ms is None or objects < 2:
        return accuracy
    return accuracy.model_copy(update={"budget_ms": accuracy.budget_ms / objects})


def _alone(request: SceneRequest, placed: Placed, accuracy: Accuracy) -> Layer:
    part = Part(placed.index, placed.asset, _of_object(request, placed.index, accuracy), placed.view)
    _check(part)
    return Layer((part,), None)


def _together(request: SceneRequest, members: Sequence[Placed], around: Frame, why: str) -> Layer:
    """Originals in one depth range: their views come from one camera for all of them."""
    if request.accuracy.source is Source.CLIPPED:
        numbers = ", ".join(str(placed.index) for placed in members)
        raise CapabilityError(f"objects {numbers} can only be drawn together, from their originals: {why}", field="accuracy.source")
    frame = sphere_around([placed.placement for placed in members])
    base = resolve_camera(request.camera, frame, request.width, request.height, around=around)
    accuracy = Accuracy(
        source=Source.ORIGINAL, antialias=request.accuracy.antialias if request.accuracy.antialias in UNMASKED else Antialias.MSAA
    )
    parts = [
        Part(placed.index, placed.asset, _of_object(request, placed.index, accuracy), view_of(placed.placement, base, frame))
        for placed in members
    ]
    return Layer(tuple(parts), why)


def _reason(group: Group) -> str:
    return TANGLED if group.tangled else CYCLE


def _of_object(request: SceneRequest, index: int, accuracy: Accuracy) -> RenderRequest:
    """One object's picture on a transparent ground; its camera is resolved apart."""
    return RenderRequest(width=request.width, height=request.height, shading=request.shading_of(index), accuracy=accuracy)


def _check(part: Part) -> None:
    """Refuse now what the drawing of this object would refuse."""
    if part.request.shading.mode in OF_THE_MESH:
        raise InvalidRequestError(
            f"{part.request.shading.mode.value} shades single meshes, not scenes", field="shading.mode", object=part.index
        )
    try:
        plan_frame(part.request, part.asset, part.view)
    except InvalidRequestError as error:
        message = f"objects[{part.index}]: {error.message}" if isinstance(error, CapabilityError) else error.message
        raise type(error)(message, field=error.where["field"], object=part.index) from error


def _is_outside(asset: MeshAsset, view: View) -> bool:
    """Whether nothing of an object can be in the picture."""
    points = asset.corners if asset.hull is None else np.asarray(asset.hull["positions"])
    return bool(screen_bounds(view.matrix, points, view.width, view.height, BORDER)[0] == NOTHING)
