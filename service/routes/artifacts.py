"""Downloads of what was made from a mesh."""

from __future__ import annotations

from anyio import to_thread
from fastapi import APIRouter, Request, Response
from fastapi.responses import FileResponse
from starlette.exceptions import HTTPException
from starlette.types import Message, Receive, Scope, Send

from schemas import keys
from schemas.artifacts import DOWNLOADS
from schemas.errors import NotFoundError
from service.caching import IMMUTABLE, entity_tag, not_modified
from service.routes.documented import problems
from service.state import Parts

router = APIRouter(prefix="/v1/meshes/{mesh_id}", tags=["downloads"])


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
    responses={200: {"content": {media: {} for media in DOWNLOADS.values()}}, **problems(404, 409, 422)},
)
async def artifact(mesh_id: str, name: str, request: Request, parts: Parts) -> Response:
    """`hull.glb` (the hull with its maps, for any glTF viewer), `normal.png`, or `color.png` where the mesh has colours."""
    await to_thread.run_sync(parts.meshes.manifest, mesh_id)
    if name not in DOWNLOADS:
        raise NotFoundError(f"The downloads of a mesh are {', '.join(DOWNLOADS)}.")
    tag = entity_tag(mesh_id, "artifact", name)
    if answer := not_modified(request, tag, IMMUTABLE):
        return answer
    try:
        path = parts.store.local_path(keys.artifact(mesh_id, name))
    except NotFoundError:
        raise NotFoundError(f"This mesh has no {name}.") from None
    return Download(path, media_type=DOWNLOADS[name], headers={"ETag": tag, "Cache-Control": IMMUTABLE})
