"""Downloads of what was made from a mesh, and hulls of other sizes."""

from __future__ import annotations

from typing import Annotated

from anyio import to_thread
from fastapi import APIRouter, Query, Request, Response
from fastapi.responses import FileResponse
from starlette.exceptions import HTTPException
from starlette.types import Message, Receive, Scope, Send

from backend.artifacts import read_artifact
from backend.glb import bare_glb
from schemas.artifacts import DOWNLOADS, FILE_VERTEX, FILE_VERTICES, HULL_GLB, ORIGINAL_GLB
from schemas.conventions import Array
from schemas.errors import InvalidRequestError, NotFoundError
from schemas.manifest import Manifest
from service.caching import IMMUTABLE, entity_tag, not_modified
from service.damage import download_path
from service.hulls import HullFile, Side, hull_file, require_hulls
from service.on_hand import manifest_of
from service.routes.documented import problems
from service.state import Parts, Services
from service.waiting import wait_for

router = APIRouter(prefix="/v1/meshes/{mesh_id}", tags=["downloads"])


MOST_NUMBER = 1 << 24
"""Whole numbers up to this are float32, the only kind that glTF has for attributes of one's own beside those of 16 bits."""


class Download(FileResponse):
    """A file, whole or in ranges. A range that cannot be had is a problem like any other, not a line of text."""

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Send it. Raises HTTPException 400 or 416, before anything is sent."""

        async def send_wanted(message: Message) -> None:
            if message["type"] == "http.response.start" and message["status"] in (400, 416):
                ranges = {k.decode(): v.decode() for k, v in message["headers"] if k == b"content-range"}
                raise HTTPException(message["status"], headers=ranges)
            await send(message)

        await super().__call__(scope, receive, send_wanted)


@router.get(
    "/artifacts/{name}",
    response_class=FileResponse,
    responses={200: {"content": {media: {} for media in DOWNLOADS.values()}}, **problems(404, 409, 422, 503)},
)
async def artifact(
    mesh_id: str,
    name: str,
    request: Request,
    parts: Parts,
    faces: Annotated[
        int | None, Query(ge=4, description="hull.glb only: a hull of at most so many faces, without maps", examples=[500])
    ] = None,
    side: Annotated[Side | None, Query(description="hull.glb only: `outer` encloses the mesh, `inner` is enclosed by it")] = None,
) -> Response:
    """`hull.glb` (the hull with its maps, for any glTF viewer), `normal.png`, or `color.png` where the mesh has colours.

    With `faces`, `side` or both, `hull.glb` is a hull of another size or side, without maps, made when it is asked for. `original.glb` is
    the mesh as it was loaded, from then on: its vertices are in the order that `positions` come in.
    """
    if name not in (*DOWNLOADS, ORIGINAL_GLB):
        await to_thread.run_sync(parts.meshes.manifest, mesh_id)
        raise NotFoundError(f"The downloads of a mesh are {', '.join((*DOWNLOADS, ORIGINAL_GLB))}.")
    if name == ORIGINAL_GLB and faces is None and side is None:
        return await _original(mesh_id, request, parts)
    manifest = await to_thread.run_sync(parts.meshes.manifest, mesh_id)
    if faces is not None or side is not None:
        if name != HULL_GLB:
            raise InvalidRequestError(f"faces and side choose a {HULL_GLB}; {name} has no such choice.", field="faces" if faces else "side")
        return await _other_hull(manifest, faces, side or Side.OUTER, request, parts)
    tag = entity_tag(mesh_id, "artifact", name)
    if answer := not_modified(request, tag, IMMUTABLE):
        return answer
    try:
        path = await to_thread.run_sync(download_path, parts.store, manifest, name)
    except NotFoundError:
        raise NotFoundError(f"This mesh has no {name}.") from None
    return Download(path, media_type=DOWNLOADS[name], headers={"ETag": tag, "Cache-Control": IMMUTABLE})


async def _original(mesh_id: str, request: Request, parts: Services) -> Response:
    """The mesh in its own vertices and faces, without colours."""
    manifest = await manifest_of(parts, mesh_id)
    tag = entity_tag(mesh_id, "artifact", ORIGINAL_GLB)
    if answer := not_modified(request, tag, IMMUTABLE):
        return answer

    def made() -> bytes:
        asset = parts.assets.get(manifest)
        return bare_glb("original", asset.positions, asset.faces, asset.frame, _numbers(parts, manifest))

    body = await wait_for(request, parts.documents.submit(made), parts.settings.render_timeout_s)
    return Response(body, media_type=DOWNLOADS[HULL_GLB], headers={"ETag": tag, "Cache-Control": IMMUTABLE})


def _numbers(parts: Services, manifest: Manifest) -> dict[str, Array]:
    """The attribute of an original that says which vertex of the upload each vertex was, where that was kept and float32 can say it."""
    if not any(FILE_VERTICES.file in stage.artifacts for stage in manifest.stages):
        return {}
    numbers = read_artifact(parts.store, manifest.id, FILE_VERTICES)["file_vertices"]
    return {FILE_VERTEX: numbers} if numbers.max(initial=0) <= MOST_NUMBER else {}


async def _other_hull(manifest: Manifest, faces: int | None, side: Side, request: Request, parts: Services) -> Response:
    """A hull of at most `faces` faces, or as many as the drawn one has."""
    require_hulls(manifest, side)
    wanted = faces or (manifest.hull.faces if manifest.hull else 0)
    tag = entity_tag(manifest.id, "hull", side.value, str(wanted))
    if answer := not_modified(request, tag, IMMUTABLE):
        return answer
    made = await wait_for(request, parts.documents.submit(_cut, parts, manifest, side, wanted), parts.settings.render_timeout_s)
    told = {"X-Hull": f"side={side.value}; faces={made.faces}; volume_excess={made.volume_excess:.6g}"}
    return Response(made.data, media_type=DOWNLOADS[HULL_GLB], headers={"ETag": tag, "Cache-Control": IMMUTABLE, **told})


def _cut(parts: Services, manifest: Manifest, side: Side, faces: int) -> HullFile:
    return hull_file(parts.store, parts.assets.get(manifest), side, faces)
