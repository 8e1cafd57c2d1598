"""The silhouette itself: edges and contours as JSON, a drawing as SVG, or bare arrays."""

from __future__ import annotations

from typing import Annotated, Any

from anyio import to_thread
from fastapi import APIRouter, Query, Request, Response

from schemas.errors import NotFoundError
from schemas.lines import LineKind
from schemas.manifest import Manifest
from schemas.render import ProjectTo, Silhouette, SilhouetteRequest
from service.assets import MeshAsset
from service.caching import REVALIDATE, entity_tag, not_modified
from service.negotiation import choose
from service.routes.documented import form_body, problems, silhouette_answer
from service.routes.query_route import QueryRoute
from service.silhouette.describe import describe_silhouette
from service.silhouette.document import silhouette_binary, silhouette_dxf, silhouette_json, silhouette_svg
from service.silhouette.levels import rounded_up
from service.silhouette.strokes import moved_px
from service.state import Parts, Services
from service.view_query import SilhouetteQuery, query_names
from service.waiting import Stopwatch, wait_for

router = APIRouter(prefix="/v1/meshes/{mesh_id}", route_class=QueryRoute, tags=["silhouettes"])

JSON, SVG, BINARY, DXF = "application/json", "image/svg+xml", "application/octet-stream", "image/vnd.dxf"
WRITERS = {JSON: silhouette_json, SVG: silhouette_svg, BINARY: silhouette_binary, DXF: silhouette_dxf}
SUFFIXES = {"json": JSON, "svg": SVG, "bin": BINARY, "dxf": DXF}
DRAWING = ProjectTo()
"""Image of a drawing whose request does not say one."""

ANSWERS: dict[str, Any] = {"response_class": Response, "responses": silhouette_answer(Silhouette) | problems(404, 406, 409, 422, 503)}


@router.post("/silhouette", **ANSWERS, openapi_extra=form_body(SilhouetteRequest))
async def silhouette(mesh_id: str, body: SilhouetteRequest, request: Request, parts: Parts) -> Response:
    """The silhouette of a view, exactly: `application/json`, `image/svg+xml`, `image/vnd.dxf` or `application/octet-stream` by Accept.

    As a form: the same JSON in `request`, and in `positions` the places that the mesh's vertices are moved to.
    """
    media = choose(request.headers.get("accept"), list(WRITERS))
    return await _document(mesh_id, body, media, request, parts)


@router.get("/silhouette.{suffix}", **ANSWERS)
async def silhouette_by_query(
    mesh_id: str, suffix: str, view: Annotated[SilhouetteQuery, Query()], request: Request, parts: Parts
) -> Response:
    """The same as a plain address: `/v1/meshes/ID/silhouette.svg?azimuth=40&width=640`; svg, dxf, json or bin."""
    if suffix not in SUFFIXES:
        raise NotFoundError("Silhouettes end with .svg, .dxf, .json or .bin.")
    with query_names():
        return await _document(mesh_id, view.request(), SUFFIXES[suffix], request, parts)


async def _document(mesh_id: str, wanted: SilhouetteRequest, media: str, request: Request, parts: Services) -> Response:
    manifest = await to_thread.run_sync(parts.meshes.manifest, mesh_id)
    wanted = completed(wanted, media)
    tag = entity_tag(mesh_id, media, wanted.model_dump_json())
    if answer := not_modified(request, tag, REVALIDATE):
        return answer
    work = parts.documents.submit(_make, parts, manifest, wanted, media)
    body, passes, accuracy = await wait_for(request, work, parts.settings.render_timeout_s)
    timing = ", ".join(f"{name};dur={ms:.3f}" for name, ms in passes)
    headers = {"X-Accuracy": accuracy, "ETag": tag, "Cache-Control": REVALIDATE, "Vary": "Accept", "Server-Timing": timing}
    return Response(body, headers=headers, media_type=media)


def completed(wanted: SilhouetteRequest, media: str) -> SilhouetteRequest:
    """The request with what a drawing needs: an image to lie in, and its lines."""
    if media not in (SVG, DXF):
        return wanted
    kinds = [LineKind.SILHOUETTE] if media == DXF and not wanted.wants_lines else wanted.kinds
    lines = kinds is not None or wanted.visible_only
    return wanted.model_copy(update={"project": wanted.project or DRAWING, "contours": not lines, "kinds": kinds})


def _make(parts: Services, manifest: Manifest, wanted: SilhouetteRequest, media: str) -> tuple[bytes, list[tuple[str, float]], str]:
    """The document, what each step took, and how exact it is; no GL."""
    return document_of(parts.assets.get(manifest), wanted, media)


def document_of(asset: MeshAsset, wanted: SilhouetteRequest, media: str) -> tuple[bytes, list[tuple[str, float]], str]:
    """The document of a mesh, what each step took, and how exact it is."""
    clock = Stopwatch()
    described = describe_silhouette(asset, wanted)
    extract_ms = clock.ms()
    body = WRITERS[media](described)
    level = described.level
    accuracy = f"surface_faces={described.faces}; error_px={'0' if level is None else rounded_up(level.error_px)}"
    passes = [] if described.lines is None else list(described.lines.passes)
    if described.lines is not None:
        moved = (wanted.simplify_px or 0.0) + (wanted.smooth_px or 0.0) + moved_px(wanted.stroke)
        accuracy += f"; line_error_px={rounded_up(moved)}"
    extract = ("extract", extract_ms - sum(ms for _, ms in passes))
    return body, [extract, *passes, ("write", clock.ms() - extract_ms)], accuracy
