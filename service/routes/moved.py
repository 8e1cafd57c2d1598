"""Pictures, silhouettes and sequences of meshes whose vertices are moved: forms, at the addresses that take JSON for a mesh at rest."""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Generic, TypeVar

from anyio import to_thread
from fastapi import APIRouter, Query, Request, Response
from fastapi.routing import APIRoute
from pydantic import BaseModel
from starlette.exceptions import HTTPException
from starlette.routing import Match
from starlette.types import Scope

from schemas.conventions import Array
from schemas.errors import InvalidRequestError, SilhouetteError
from schemas.manifest import Manifest
from schemas.plan import PlanReport
from schemas.render import RenderRequest, SilhouetteRequest
from schemas.sequence import SequenceRequest
from service.access.caller import caller_of
from service.assets import MeshAsset
from service.caching import NOT_KEPT
from service.forms import REQUEST, Body, Spool, content_type_of, is_form, parsed, receive_form
from service.moving import FIELD, Moving
from service.negotiation import IMAGE_TYPES, choose, image_format, wants_json
from service.on_hand import asset_of, manifest_of
from service.owners import owner_of
from service.positions import poses_in
from service.render.encode import encode
from service.render.explain import explain as explain_plan
from service.routes.frames import sequence, sequence_form
from service.routes.render import picture_headers
from service.routes.silhouette import WRITERS, completed, document_of
from service.state import Parts, Services
from service.uploads import check_room
from service.waiting import Stopwatch, wait_for

Wanted = TypeVar("Wanted", bound=BaseModel)


class FormRoute(APIRoute):
    """A route for forms alone: whatever else comes to its address is for the routes after it."""

    def matches(self, scope: Scope) -> tuple[Match, Scope]:
        """No match without a form."""
        match, child = super().matches(scope)
        return (match, child) if scope["type"] == "http" and is_form(scope) else (Match.NONE, {})


router = APIRouter(prefix="/v1/meshes/{mesh_id}", route_class=FormRoute, include_in_schema=False)


@dataclass(frozen=True)
class Asked(Generic[Wanted]):
    """What a form says of a mesh. positions: the file of them, as long as the request lasts; None where the form has none."""

    manifest: Manifest
    wanted: Wanted
    positions: Path | None

    def poses(self, vertices: int, *, one: bool) -> Array:
        """(k, v, 3): the poses in the file; one: exactly that. Raises InvalidRequestError, for none too."""
        if self.positions is None:
            raise InvalidRequestError(
                f"The form has no field `{FIELD}` with the places of the mesh's vertices.", field=FIELD, vertices=vertices
            )
        poses = poses_in(self.positions, vertices)
        if one and len(poses) != 1:
            message = f"one pose makes one answer, and these are {len(poses):,} of {vertices:,} vertices each"
            raise InvalidRequestError(message, field=FIELD, vertices=vertices, poses=len(poses))
        return poses


@router.post("/render")
async def render_moved(mesh_id: str, request: Request, parts: Parts, explain: Annotated[bool, Query()] = False) -> Response:
    """One picture of the mesh with its vertices at `positions`; `request` is what a body of JSON would be."""
    limit_s = parts.settings.render_timeout_s
    async with asked(mesh_id, request, parts, RenderRequest) as form:
        wanted, accept = form.wanted, request.headers.get("accept")
        caller_of(request).check_picture(wanted.width, wanted.height)
        if explain or (wanted.format is None and wants_json(accept)):
            return await _plan(form, request, parts)
        encoding = wanted.format or image_format(accept)
        asset, pose_ms = await wait_for(request, parts.cpu.submit(_moved, parts, form), limit_s)
    image = await wait_for(request, parts.renderer.submit_once(asset, wanted, owner_of(request)), limit_s)
    clock = Stopwatch()
    body = await wait_for(request, parts.cpu.submit(encode, image.pixels, encoding), limit_s)
    told = picture_headers(image, before=[("pose", pose_ms)], after=[("encode", clock.ms())])
    return Response(body, headers={"Cache-Control": NOT_KEPT, "Vary": "Accept", **told}, media_type=IMAGE_TYPES[encoding])


@router.post("/silhouette")
async def silhouette_moved(mesh_id: str, request: Request, parts: Parts) -> Response:
    """The silhouette of the mesh with its vertices at `positions`, found without a tree; `request` as for a mesh at rest."""
    media = choose(request.headers.get("accept"), list(WRITERS))
    async with asked(mesh_id, request, parts, SilhouetteRequest) as form:
        work = parts.documents.submit(_document, parts, form, media)
        body, passes, accuracy = await wait_for(request, work, parts.settings.render_timeout_s)
    timing = ", ".join(f"{name};dur={ms:.3f}" for name, ms in passes)
    headers = {"X-Accuracy": accuracy, "Cache-Control": NOT_KEPT, "Vary": "Accept", "Server-Timing": timing}
    return Response(body, headers=headers, media_type=media)


@router.post("/frames")
async def frames_moved(mesh_id: str, request: Request, parts: Parts) -> Response:
    """A sequence whose frames have vertices at `positions`, those of a frame after those of another; without any, as by JSON."""
    async with asked(mesh_id, request, parts, SequenceRequest) as form:
        file_form = sequence_form(form.wanted, request)
        if form.positions is None:
            poses = None
        else:
            asset = await asset_of(request, parts, form.manifest)
            poses = await to_thread.run_sync(lambda: form.poses(len(asset.positions), one=False))
        return await sequence(form.manifest, form.wanted, poses, file_form, request, parts)


@asynccontextmanager
async def asked(mesh_id: str, request: Request, parts: Services, model: type[Wanted]) -> AsyncIterator[Asked[Wanted]]:
    """What a form asks of a mesh that can be drawn; its positions are gone afterwards.

    Raises NotFoundError, NotReadyError, FailedMeshError, what `receive_form` raises, StorageFullError, InvalidRequestError for fields that
    are none, and RequestValidationError.
    """
    body = Body(request)
    with parts.store.temporary() as file:
        try:
            manifest = await manifest_of(parts, mesh_id)
            limits = parts.upload_limits.of(caller_of(request))
            check_room(int(request.headers.get("content-length", "0")), limits)
            spool, boundary = Spool(file, limits.max_bytes), content_type_of(request.headers)[1]
            fields, name = await receive_form(body, boundary, spool, FIELD, parts.settings.max_body_kib * 1024)
            await spool.flush()
            wanted = _wanted(model, fields)
        except (SilhouetteError, HTTPException):
            await body.drain()
            raise
        yield Asked(manifest, wanted, None if name is None else Path(file.name))


def _wanted(model: type[Wanted], fields: dict[str, str]) -> Wanted:
    for name in fields:
        if name != REQUEST:
            raise InvalidRequestError(f"The fields of the form are `{REQUEST}`, JSON, and `{FIELD}`; there is no {name}.", field=name)
    return parsed(model, fields.get(REQUEST, "{}"))


def _moved(parts: Services, form: Asked[Wanted]) -> tuple[MeshAsset, float]:
    """The mesh in its pose, and the milliseconds that took."""
    base = parts.assets.get(form.manifest)
    clock = Stopwatch()
    return Moving(base).at(form.poses(len(base.positions), one=True)[0]), clock.ms()


def _document(parts: Services, form: Asked[SilhouetteRequest], media: str) -> tuple[bytes, list[tuple[str, float]], str]:
    asset, pose_ms = _moved(parts, form)
    body, passes, accuracy = document_of(asset, completed(form.wanted, media), media)
    return body, [("pose", pose_ms), *passes], accuracy


async def _plan(form: Asked[RenderRequest], request: Request, parts: Services) -> Response:
    """What a picture would do."""

    def planned() -> PlanReport:
        return explain_plan(form.wanted, _moved(parts, form)[0], parts.renderer.costs)

    report = await wait_for(request, parts.cpu.submit(planned), parts.settings.render_timeout_s)
    body = report.model_dump_json(exclude_none=True)
    return Response(body, headers={"Cache-Control": NOT_KEPT, "Vary": "Accept"}, media_type="application/json")
