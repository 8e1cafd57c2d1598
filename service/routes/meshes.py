"""Uploading, listing, watching and deleting meshes."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import AsyncIterator
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Any

import redis
from anyio import to_thread
from fastapi import APIRouter, Query, Request, Response
from fastapi.responses import StreamingResponse

from backend import records
from schemas import keys
from schemas.errors import NotFoundError, StoreUnavailableError
from schemas.manifest import Accepted
from schemas.mesh import MeshInfo, MeshPage, MeshStatus
from service.access.caller import caller_of
from service.meshes import NO_SUCH_MESH
from service.routes.documented import UPLOAD_BODY, problems
from service.state import Parts, Services
from service.uploads import Upload, receive_upload

log = logging.getLogger("silhouette.service")
router = APIRouter(prefix="/v1/meshes", tags=["meshes"])

POLL_S = 0.2
"""Between two looks at a mesh for its event stream: a stage reports at most every quarter of a second."""

KEEP_ALIVE_S = 10.0
"""Between two comments on a silent event stream, so that proxies keep it and a client that left is noticed."""


@router.post(
    "",
    status_code=202,
    response_model=MeshInfo,
    response_model_exclude_none=True,
    openapi_extra=UPLOAD_BODY,
    responses={
        200: {"model": MeshInfo, "description": "This mesh with these options is known already"},
        **problems(413, 415, 422, 503, 507),
    },
)
async def upload_mesh(request: Request, parts: Parts) -> Response:
    """Upload a mesh: its bytes as the body with `?name=knot.ply`, or a form with a field `file`.

    The same bytes with the same options are the same mesh, so uploading again costs nothing but the transfer and a comparison. A mesh that
    failed with the code `damaged-upload` is in work again then.
    """
    with parts.store.temporary() as file:
        upload = await receive_upload(request, file, parts.upload_limits.of(caller_of(request)))
        info, is_new = await to_thread.run_sync(_accept, parts, upload, Path(file.name))
    headers = {"Location": info.links["self"], "Cache-Control": "no-store"}
    return Response(_json(info), 202 if is_new else 200, headers, "application/json")


PLACE: dict[str, Any] = {"anyOf": [{"type": "string", "pattern": "^[0-9]{1,19}-[0-9a-f]{32}$"}, {"type": "null"}]}


@router.get("", response_model=MeshPage, response_model_exclude_none=True, responses=problems(422, 503))
def list_meshes(
    parts: Parts,
    limit: Annotated[int, Query(ge=1, le=200, description="meshes on a page")] = 50,
    after: Annotated[str | None, Query(description="place in the list, from `next` of the page before", json_schema_extra=PLACE)] = None,
) -> MeshPage:
    """A page of meshes, newest first; `next` leads to the following one."""
    return parts.meshes.page(limit, after)


@router.get("/{mesh_id}", response_model=MeshInfo, response_model_exclude_none=True, responses=problems(404, 422, 503))
def mesh_info(mesh_id: str, parts: Parts) -> MeshInfo:
    """Status, stages, measured facts, capabilities and links of a mesh."""
    return parts.meshes.info(mesh_id)


@router.get(
    "/{mesh_id}/events",
    response_class=StreamingResponse,
    responses={200: {"content": {"text/event-stream": {}}, "description": "`data:` is a MeshInfo"}, **problems(404, 422, 503)},
)
async def mesh_events(mesh_id: str, parts: Parts) -> StreamingResponse:
    """Server-sent events: a MeshInfo on each change until the mesh is ready or failed, then the stream ends."""
    first = await to_thread.run_sync(parts.meshes.info, mesh_id)
    return StreamingResponse(_events(first, parts), media_type="text/event-stream", headers={"Cache-Control": "no-store"})


@router.delete("/{mesh_id}", status_code=204, response_class=Response, responses=problems(404, 422, 503))
def delete_mesh(mesh_id: str, parts: Parts) -> Response:
    """Cancel what is being done for a mesh and remove everything of it."""
    existed = bool(keys.MESH_ID.match(mesh_id)) and parts.queue.cancel(mesh_id)
    parts.meshes.forget(mesh_id)
    parts.assets.drop(mesh_id)
    if not existed:
        raise NotFoundError(NO_SUCH_MESH)
    return Response(status_code=204)


def _accept(parts: Services, upload: Upload, path: Path) -> tuple[MeshInfo, bool]:
    """Make the upload durable and set its work going; whether it was new, or mends what was damaged. Blocks."""
    mesh_id = keys.mesh_id(upload.sha256, upload.extension, upload.options)
    accepted = Accepted(
        id=mesh_id,
        name=upload.name,
        extension=upload.extension,
        upload_sha256=upload.sha256,
        upload_bytes=upload.size,
        options=upload.options,
        created=datetime.now(UTC),
    )
    is_new = records.accept(parts.store, accepted, path)
    try:
        parts.queue.advance(mesh_id)
    except redis.RedisError as error:  # accepted all the same: the reconciler brings it to the queue
        log.warning("not enqueued yet: %s", error, extra={"mesh": mesh_id})
    return parts.meshes.info(mesh_id), is_new


async def _events(info: MeshInfo, parts: Services) -> AsyncIterator[bytes]:
    silent_s, poll_s = 0.0, max(POLL_S, parts.store.look_interval_s)
    body = _json(info)
    yield b"data: " + body + b"\n\n"
    while info.status in (MeshStatus.QUEUED, MeshStatus.PROCESSING):
        await asyncio.sleep(poll_s)
        silent_s += poll_s
        try:
            info = await to_thread.run_sync(parts.meshes.info, info.id)
        except NotFoundError:
            yield b"event: deleted\ndata: {}\n\n"
            return
        except StoreUnavailableError as error:  # what it said last holds until it answers again
            log.warning("events wait: %s", error, extra={"mesh": info.id})
        if (new := _json(info)) != body:
            body, silent_s = new, 0.0
            yield b"data: " + body + b"\n\n"
        elif silent_s >= KEEP_ALIVE_S:
            silent_s = 0.0
            yield b": still here\n\n"


def _json(info: MeshInfo) -> bytes:
    document: Any = info.model_dump_json(exclude_none=True)
    return bytes(document, "utf-8")
