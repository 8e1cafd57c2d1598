"""Sequences of pictures: turntables, flights and moving meshes."""

from __future__ import annotations

from typing import Annotated, Any

from fastapi import APIRouter, Query, Request, Response

from schemas.conventions import Array
from schemas.errors import NotFoundError
from schemas.manifest import Manifest
from schemas.sequence import SequenceFormat, SequenceRequest
from service.access.caller import caller_of
from service.animation import animation
from service.assets import state_of
from service.caching import NOT_KEPT, REVALIDATE, entity_tag, not_modified
from service.negotiation import choose
from service.on_hand import asset_of, manifest_of
from service.routes.documented import form_body, problems, sequence_answer
from service.routes.query_route import QueryRoute
from service.routes.render import check_drawable, picture_headers
from service.sequence import Drawing
from service.state import Parts, Services
from service.view_query import TurntableQuery, query_names
from service.waiting import Stopwatch, wait_for

router = APIRouter(prefix="/v1/meshes/{mesh_id}", route_class=QueryRoute, tags=["pictures"])

SEQUENCE_TYPES = {SequenceFormat.WEBP: "image/webp", SequenceFormat.APNG: "image/apng", SequenceFormat.ZIP: "application/zip"}
"""Media type of each form, in the service's own order of preference."""
SUFFIXES = {"webp": SequenceFormat.WEBP, "png": SequenceFormat.APNG, "zip": SequenceFormat.ZIP}
TURNTABLES: dict[str, Any] = {
    "response_class": Response,
    "responses": sequence_answer(*SEQUENCE_TYPES.values()) | problems(404, 409, 422, 503),
}
SEQUENCES: dict[str, Any] = {
    "response_class": Response,
    "responses": sequence_answer(*SEQUENCE_TYPES.values()) | problems(404, 406, 409, 413, 422, 503, 507),
    "openapi_extra": form_body(SequenceRequest),
}


@router.post("/frames", **SEQUENCES)
async def frames(mesh_id: str, body: SequenceRequest, request: Request, parts: Parts) -> Response:
    """Pictures one after the other, as an animation or an archive: a turntable by `turn`, a flight by `cameras`.

    As a form: the same JSON in `request`, and in `positions` those of the mesh's vertices in each frame. The file is `format`, else what
    Accept asks for, else an animated WebP.
    """
    form = sequence_form(body, request)
    manifest = await manifest_of(parts, mesh_id)
    check_drawable(manifest, body.accuracy)
    return await sequence(manifest, body, None, form, request, parts)


@router.get("/turntable.{suffix}", **TURNTABLES)
async def turntable(mesh_id: str, suffix: str, view: Annotated[TurntableQuery, Query()], request: Request, parts: Parts) -> Response:
    """A mesh turning round as a plain address, for `<img src>`: `/v1/meshes/ID/turntable.webp?frames=36`; webp, png (animated) or zip."""
    if suffix not in SUFFIXES:
        raise NotFoundError("Turntables end with .webp, .png or .zip.")
    manifest = await manifest_of(parts, mesh_id)
    with query_names():
        wanted = view.sequence(SUFFIXES[suffix])
        check_drawable(manifest, wanted.accuracy)
        tag = entity_tag(mesh_id, state_of(manifest), "turntable", wanted.model_dump_json())
        if answer := not_modified(request, tag, REVALIDATE):
            return answer
        answer = await sequence(manifest, wanted, None, SUFFIXES[suffix], request, parts)
    answer.headers.update({"ETag": tag, "Cache-Control": REVALIDATE})
    return answer


def sequence_form(wanted: SequenceRequest, request: Request) -> SequenceFormat:
    """What the frames come in. Raises HTTPException 406."""
    if wanted.format is not None:
        return wanted.format
    media = choose(request.headers.get("accept"), list(SEQUENCE_TYPES.values()))
    return next(form for form, name in SEQUENCE_TYPES.items() if name == media)


async def sequence(
    manifest: Manifest, wanted: SequenceRequest, poses: Array | None, form: SequenceFormat, request: Request, parts: Services
) -> Response:
    """The frames of a mesh, whose vertices are in as many poses, or in one, or stay where they are."""
    caller_of(request).check_picture(wanted.width, wanted.height)
    limit_s = parts.settings.render_timeout_s
    asset = await asset_of(request, parts, manifest)
    drawn = await Drawing(request, parts, asset, wanted, poses).frames(form)
    clock = Stopwatch()
    body = await wait_for(request, parts.documents.submit(animation, drawn.pictures, form, wanted.fps, wanted.loop), limit_s)
    told = picture_headers(drawn.summed, after=[("write", clock.ms())])
    count = len(drawn.pictures)
    told |= {"Server-Timing": f'{told["Server-Timing"]}, frames;desc="{count}"', "X-Frames": str(count)}
    return Response(body, headers={"Cache-Control": NOT_KEPT, "Vary": "Accept", **told}, media_type=SEQUENCE_TYPES[form])
