"""Pictures: by request body, by query parameters for `<img src>`, and the thumbnail."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Any

from fastapi import APIRouter, Query, Request, Response

from backend.manifests import NOT_ENDED
from schemas.errors import NotFoundError, NotReadyError
from schemas.manifest import Manifest
from schemas.plan import PlanReport
from schemas.render import Accuracy, ImageFormat, RenderRequest, Source
from service.access.caller import caller_of
from service.assets import CLIP, READY, state_of
from service.caching import IMMUTABLE, NOT_KEPT, REVALIDATE, entity_tag, not_modified
from service.negotiation import IMAGE_TYPES, SUFFIXES, image_format, wants_json
from service.on_hand import asset_of, manifest_of
from service.owners import owner_of
from service.picture_cache import KeptPicture
from service.render.encode import encode
from service.render.explain import explain as explain_plan
from service.render.renderer import RenderedImage
from service.routes.documented import form_body, image_answer, problems
from service.routes.query_route import QueryRoute
from service.silhouette.levels import rounded_up
from service.state import Parts, Services
from service.view_query import RenderQuery, ThumbnailQuery, query_names
from service.waiting import Stopwatch, wait_for

router = APIRouter(prefix="/v1/meshes/{mesh_id}", route_class=QueryRoute, tags=["pictures"])

PICTURES: dict[str, Any] = {
    "response_class": Response,
    "responses": image_answer(*IMAGE_TYPES.values()) | problems(404, 406, 409, 422, 503),
}
PICTURES_AND_PLANS: dict[str, Any] = {
    "response_class": Response,
    "responses": image_answer(*IMAGE_TYPES.values(), plan=PlanReport) | problems(404, 406, 409, 413, 422, 503, 507),
    "openapi_extra": form_body(RenderRequest),
}


@router.post("/render", **PICTURES_AND_PLANS)
async def render(
    mesh_id: str,
    body: RenderRequest,
    request: Request,
    parts: Parts,
    explain: Annotated[bool, Query(description="answer with the plan, its reasons and its predicted cost; nothing is drawn")] = False,
) -> Response:
    """One picture. The encoding is `format`, else what Accept asks for, else PNG; raw is RGBA, 4 bytes a pixel, top row first.

    With `?explain=true`, or `Accept: application/json`, the plan instead of the picture. As a form: the same JSON in `request`, and in
    `positions` the places that the mesh's vertices are moved to.
    """
    if explain or (body.format is None and wants_json(request.headers.get("accept"))):
        return await _plan(mesh_id, body, request, parts)
    wanted = body if body.format else body.model_copy(update={"format": image_format(request.headers.get("accept"))})
    return await _picture(mesh_id, wanted, request, parts, REVALIDATE)


@router.get("/render.{suffix}", **PICTURES)
async def render_by_query(mesh_id: str, suffix: str, view: Annotated[RenderQuery, Query()], request: Request, parts: Parts) -> Response:
    """The same as a plain address, for `<img src>`: `/v1/meshes/ID/render.png?azimuth=40&width=640`; png, webp or jpg."""
    encoding = _encoding(suffix)
    with query_names():
        return await _picture(mesh_id, view.request(encoding), request, parts, REVALIDATE)


@router.get("/thumbnail.{suffix}", **PICTURES)
async def thumbnail(
    mesh_id: str,
    suffix: str,
    view: Annotated[ThumbnailQuery, Query()],
    request: Request,
    parts: Parts,
) -> Response:
    """A fitted three-quarter view on a transparent ground, from a mesh that is ready the same for ever: keep it as long as you like."""
    wanted = RenderRequest(width=view.size, height=view.size, format=_encoding(suffix))
    return await _picture(mesh_id, wanted, request, parts, IMMUTABLE)


def _encoding(suffix: str) -> ImageFormat:
    if suffix not in SUFFIXES:
        raise NotFoundError("Pictures end with .png, .webp or .jpg.")
    return SUFFIXES[suffix]


async def _picture(mesh_id: str, wanted: RenderRequest, request: Request, parts: Services, cache_control: str) -> Response:
    """Render `wanted`, whose format is set, unless the client has it already."""
    caller_of(request).check_picture(wanted.width, wanted.height)
    manifest = await manifest_of(parts, mesh_id)
    check_drawable(manifest, wanted.accuracy)
    if manifest.status != READY:
        cache_control = REVALIDATE
    tag = entity_tag(mesh_id, state_of(manifest), "picture", wanted.model_dump_json())
    if answer := not_modified(request, tag, cache_control):
        return answer
    if kept := parts.pictures.get(tag):
        return _answer(kept, wanted, tag, cache_control, CACHED)
    async with parts.pictures.alone(tag, parts.settings.render_timeout_s) as kept:
        if kept is not None:
            return _answer(kept, wanted, tag, cache_control, CACHED)
        picture, timing = await _drawn(manifest, wanted, request, parts)
        if wanted.accuracy.budget_ms is None:  # what fits a budget changes as costs are learned
            parts.pictures.put(tag, picture)
    return _answer(picture, wanted, tag, cache_control, timing)


CACHED = "cache;desc=hit"
"""`Server-Timing` of a picture that was drawn before."""


def _answer(picture: KeptPicture, wanted: RenderRequest, tag: str, cache_control: str, timing: str) -> Response:
    headers = {"ETag": tag, "Cache-Control": cache_control, "Vary": "Accept", "Server-Timing": timing, **picture.headers}
    return Response(picture.body, headers=headers, media_type=IMAGE_TYPES[wanted.format or ImageFormat.PNG])


async def _drawn(manifest: Manifest, wanted: RenderRequest, request: Request, parts: Services) -> tuple[KeptPicture, str]:
    """The picture, and what each step of it took."""
    limit_s = parts.settings.render_timeout_s
    asset = await asset_of(request, parts, manifest)
    image = await wait_for(request, parts.renderer.submit(asset, wanted, owner_of(request), encodes=True), limit_s)
    clock, body, after = Stopwatch(), image.body, list[tuple[str, float]]()
    if body is None:
        body = await wait_for(request, parts.cpu.submit(encode, image.pixels, wanted.format or ImageFormat.PNG), limit_s)
        after = [("encode", clock.ms())]
    headers = picture_headers(image, after=after)
    timing = headers.pop("Server-Timing")
    return KeptPicture(body, headers), timing


async def _plan(mesh_id: str, wanted: RenderRequest, request: Request, parts: Services) -> Response:
    """What `wanted` would do. The costs change as frames are drawn: not to be kept."""
    manifest = await manifest_of(parts, mesh_id)
    check_drawable(manifest, wanted.accuracy)

    def planned() -> PlanReport:
        return explain_plan(wanted, parts.assets.get(manifest), parts.renderer.costs)

    report = await wait_for(request, parts.cpu.submit(planned), parts.settings.render_timeout_s)
    body = report.model_dump_json(exclude_none=True)
    return Response(body, headers={"Cache-Control": NOT_KEPT, "Vary": "Accept"}, media_type="application/json")


def check_drawable(manifest: Manifest, accuracy: Accuracy) -> None:
    """Raise NotReadyError for a picture that takes a silhouette or hull which the mesh is still to get."""
    clip = manifest.capabilities.get(CLIP)
    if clip is not None and clip.reason == NOT_ENDED and (accuracy.source is Source.CLIPPED or accuracy.smooth):
        raise NotReadyError("The mesh cannot be clipped yet: its preprocessing has not ended.", mesh=manifest.id)


def picture_headers(
    image: RenderedImage, *, before: Sequence[tuple[str, float]] = (), after: Sequence[tuple[str, float]] = ()
) -> dict[str, str]:
    """What a picture says of itself: where the time went, what ran, how exact it is. before, after: (name, ms) of other steps."""
    passes = [*before, *image.passes, *after]
    height, width = image.pixels.shape[:2]
    return {
        "Server-Timing": ", ".join(f"{name};dur={ms:.3f}" for name, ms in passes),
        "X-Plan": ", ".join(image.plan),
        "X-Accuracy": f"rung={image.rung}{_error(image)}",
        "X-Image-Size": f"{width}x{height}",
    }


def _error(image: RenderedImage) -> str:
    """How far the outline may be off, what that rests on, what was drawn instead of the mesh, and what could not be kept."""
    told = [] if image.error_px is None else [f"error_px={rounded_up(image.error_px)}"]
    plan = image.planned
    if plan is not None:
        told += [] if image.error_px is None else [f"bound={plan.choice.bound}"]
        if plan.level is not None:
            told += [f"level_faces={len(plan.level.level.faces)}", f"level_error_px={rounded_up(plan.level.error_px)}"]
        told += [f"missed={'+'.join(plan.choice.missed)}"] if plan.choice.missed else []
    return "".join(f"; {item}" for item in told)
