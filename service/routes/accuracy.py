"""What accuracy costs: the measured ladder of a mesh."""

from __future__ import annotations

from typing import Annotated, Any

from anyio import to_thread
from fastapi import APIRouter, Query, Request, Response

from schemas.errors import BusyError, NotReadyError
from schemas.ladder import AccuracyReport, Ladder
from schemas.manifest import Manifest
from service.accuracy.plot import accuracy_svg
from service.accuracy.report import Times, accuracy_report
from service.assets import MeshAsset
from service.caching import REVALIDATE, entity_tag, not_modified
from service.costs import ViewTerms, added_px
from service.errors import FailedMeshError
from service.negotiation import JSON, choose
from service.on_hand import manifest_of
from service.routes.documented import ACCURACY_EXAMPLE, problems
from service.rungs import key_of
from service.state import Parts, Services
from service.waiting import wait_for

router = APIRouter(prefix="/v1/meshes/{mesh_id}", tags=["accuracy"])

SVG = "image/svg+xml"
Size = Annotated[
    int | None, Query(ge=1, le=8192, description="side of the pictures, pixels: the nearest measured one; the largest if not given")
]
Device = Annotated[str | None, Query(description="renderer that the times are of; the one that was measured on if not given")]
ANSWERS: dict[str, Any] = {
    "response_class": Response,
    "responses": {
        200: {"model": AccuracyReport, "description": "The ladder", "content": {JSON: {"example": ACCURACY_EXAMPLE}, SVG: {}}},
        304: {"description": "The client has it already"},
        **problems(404, 406, 409, 422, 503),
    },
}


@router.get("/accuracy", **ANSWERS)
async def accuracy(mesh_id: str, request: Request, parts: Parts, size: Size = None, device: Device = None) -> Response:
    """Every way this mesh can be drawn: how exact each is, and what it costs; `application/json`, or the plot as `image/svg+xml`."""
    return await _answer(mesh_id, size, device, choose(request.headers.get("accept"), [JSON, SVG]), request, parts)


@router.get("/accuracy.svg", **ANSWERS)
async def accuracy_plot(mesh_id: str, request: Request, parts: Parts, size: Size = None, device: Device = None) -> Response:
    """The plot: error against milliseconds, with the rungs that no other one beats; works in an `<img>`."""
    return await _answer(mesh_id, size, device, SVG, request, parts)


async def _answer(mesh_id: str, size: int | None, device: str | None, media: str, request: Request, parts: Services) -> Response:
    manifest = await manifest_of(parts, mesh_id)
    info = await to_thread.run_sync(parts.meshes.info, mesh_id)
    work = parts.documents.submit(_report, parts, manifest, info.name, size, device)
    report = await wait_for(request, work, parts.settings.render_timeout_s)
    faces = None if manifest.stats is None else manifest.stats.faces
    body = accuracy_svg(report, faces) if media == SVG else report.model_dump_json(exclude_none=True)
    tag = entity_tag(mesh_id, media, body)
    if answer := not_modified(request, tag, REVALIDATE):
        return answer
    return Response(body, headers={"ETag": tag, "Cache-Control": REVALIDATE, "Vary": "Accept"}, media_type=media)


def _report(parts: Services, manifest: Manifest, name: str, size: int | None, device: str | None) -> AccuracyReport:
    ladder = _ladder(parts, manifest)
    asset = parts.assets.get(manifest)
    return accuracy_report(manifest.id, name, ladder, size, device, _predicted(parts, asset, ladder))


def _ladder(parts: Services, manifest: Manifest) -> Ladder:
    """The measured ladder. Raises NotReadyError with the reason when there is none, FailedMeshError when measuring failed."""
    ladder = None if manifest.status != "ready" else parts.assets.get(manifest).ladder
    if ladder is not None:
        return ladder
    for record in manifest.stages:  # the first that failed: what comes after it is skipped
        if record.outcome == "failed" and record.error is not None:
            raise FailedMeshError(record.error)
    if not parts.settings.measure:
        raise NotReadyError("This mesh has not been measured, and measuring is switched off here (SILHOUETTE_MEASURE).", mesh=manifest.id)
    raise NotReadyError("This mesh has not been measured yet; that comes by itself when nothing else is to be done.", mesh=manifest.id)


def _predicted(parts: Services, asset: MeshAsset, ladder: Ladder) -> Times:
    """Times on this service's own renderer; of none, where the ladder is of other rungs than the mesh has now."""
    try:
        costs = parts.renderer.costs
    except BusyError:
        return {}
    number = {key: n for n, key in enumerate(asset.rungs.keys)}
    if any(key_of(rung) not in number for rung in ladder.rungs):
        return {}
    times: dict[int, list[float]] = {}
    for facts in ladder.facts:
        times[facts.size] = []
        for rung in ladder.rungs:
            at = next(one for one in rung.sizes if one.size == facts.size)
            view = ViewTerms(facts.area_px, float(facts.size**2), added_px(at, rung))
            times[facts.size].append(costs.frame_ms(asset, number[key_of(rung)], view))
    return {costs.device: times}
