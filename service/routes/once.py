"""A picture or a silhouette of a mesh in the same request: nothing is prepared, nothing is kept."""

from __future__ import annotations

from typing import Annotated, Any, Literal, TypeVar

from fastapi import APIRouter, Query, Request, Response
from pydantic import Field

from schemas.errors import InvalidRequestError
from schemas.render import ImageFormat, RenderRequest, Silhouette, SilhouetteRequest
from service.access.caller import caller_of
from service.caching import NOT_KEPT
from service.forms import REQUEST, parsed
from service.negotiation import IMAGE_TYPES, choose, image_format
from service.once import OneMesh, mesh_of
from service.owners import owner_of
from service.render.encode import encode
from service.routes.documented import image_answer, once_body, problems, silhouette_answer
from service.routes.render import picture_headers
from service.routes.silhouette import WRITERS, completed, document_of
from service.state import Parts, Services
from service.view_query import RenderQuery, SilhouetteQuery, query_names
from service.waiting import Stopwatch, wait_for

router = APIRouter(prefix="/v1", tags=["one request"])

Wanted = TypeVar("Wanted", RenderRequest, SilhouetteRequest)
Repair = Annotated[Literal["auto", "never"], Field(description="close small holes and orient faces, or take the mesh as it is")]
Name = Annotated[str, Field(description="file name of a body that is no form; its ending says the format", examples=["knot.ply"])]
OF_THE_MESH = {"name", "repair"}


class OnceRenderQuery(RenderQuery):
    """A picture of the mesh in the body."""

    name: Name = ""
    repair: Repair = "auto"


class OnceSilhouetteQuery(SilhouetteQuery):
    """A silhouette of the mesh in the body."""

    name: Name = ""
    repair: Repair = "auto"


PICTURE: dict[str, Any] = {
    "response_class": Response,
    "responses": image_answer(*IMAGE_TYPES.values()) | problems(406, 413, 415, 422, 503, 507),
    "openapi_extra": once_body(RenderRequest),
}
SILHOUETTE: dict[str, Any] = {
    "response_class": Response,
    "responses": silhouette_answer(Silhouette) | problems(406, 413, 415, 422, 503, 507),
    "openapi_extra": once_body(SilhouetteRequest),
}


@router.post("/render", **PICTURE)
async def render_once(view: Annotated[OnceRenderQuery, Query()], request: Request, parts: Parts) -> Response:
    """One picture of a mesh that is not kept: `curl --data-binary @knot.ply 'http://host/v1/render?name=knot.ply&azimuth=40' -o knot.png`.

    Or a form: the mesh in `file`, and in `request` what `/v1/meshes/{mesh_id}/render` takes. Drawn from the mesh itself.
    """
    with query_names():
        by_query = view.request(image_format(request.headers.get("accept")))
    async with mesh_of(request, parts, _beside(view)) as mesh:
        wanted = _wanted(RenderRequest, mesh, view, by_query)
        caller_of(request).check_picture(wanted.width, wanted.height)
        wanted = wanted if wanted.format else wanted.model_copy(update={"format": by_query.format})
        drawing = parts.renderer.submit_once(mesh.asset, wanted, owner_of(request))
        image = await wait_for(request, drawing, parts.settings.render_timeout_s)
    clock = Stopwatch()
    encoding = wanted.format or ImageFormat.PNG
    body = await wait_for(request, parts.cpu.submit(encode, image.pixels, encoding), parts.settings.render_timeout_s)
    headers = picture_headers(image, before=[("load", mesh.load_ms)], after=[("encode", clock.ms())])
    return Response(body, headers={"Cache-Control": NOT_KEPT, **headers}, media_type=IMAGE_TYPES[encoding])


@router.post("/silhouette", **SILHOUETTE)
async def silhouette_once(view: Annotated[OnceSilhouetteQuery, Query()], request: Request, parts: Parts) -> Response:
    """The silhouette of a mesh that is not kept: `application/json`, `image/svg+xml`, or `application/octet-stream` by Accept.

    The body is that of `/v1/render`, with the request of `/v1/meshes/{mesh_id}/silhouette` in a form.
    """
    media = choose(request.headers.get("accept"), list(WRITERS))
    with query_names():
        by_query = view.request()
    async with mesh_of(request, parts, _beside(view)) as mesh:
        wanted = completed(_wanted(SilhouetteRequest, mesh, view, by_query), media)
        body, passes, accuracy = await _document(mesh, wanted, media, request, parts)
    timing = ", ".join(f"{name};dur={ms:.3f}" for name, ms in [("load", mesh.load_ms), *passes])
    headers = {"X-Accuracy": accuracy, "Cache-Control": NOT_KEPT, "Vary": "Accept", "Server-Timing": timing}
    return Response(body, headers=headers, media_type=media)


async def _document(
    mesh: OneMesh, wanted: SilhouetteRequest, media: str, request: Request, parts: Services
) -> tuple[bytes, list[tuple[str, float]], str]:
    work = parts.documents.submit(document_of, mesh.asset, wanted, media)
    return await wait_for(request, work, parts.settings.render_timeout_s)


def _beside(view: RenderQuery | SilhouetteQuery) -> set[str]:
    """Fields that are not about reading the mesh: the sizes of a hull that is not made are among them."""
    return set(type(view).model_fields) - OF_THE_MESH | {REQUEST}


def _wanted(model: type[Wanted], mesh: OneMesh, view: RenderQuery | SilhouetteQuery, by_query: Wanted) -> Wanted:
    """The request in the form, or that of the query. Raises InvalidRequestError when there are both, RequestValidationError."""
    for name in mesh.upload.beside:
        if name != REQUEST:
            raise InvalidRequestError(f"{name} belongs into the field `{REQUEST}` of the form, or into the address.", field=name)
    text = mesh.upload.beside.get(REQUEST)
    if text is None:
        return by_query
    if view.model_fields_set - OF_THE_MESH:
        raise InvalidRequestError(f"The form has a `{REQUEST}`, and the address says a view, too: one of them.", field=REQUEST)
    return parsed(model, text)
