"""What a request does that meets a damaged file of a mesh: it has the mesh's stage run again, and says that it is not ready."""

from __future__ import annotations

from pathlib import Path
from typing import cast

from anyio import to_thread
from fastapi import FastAPI, Request, Response

from backend.store import Store
from schemas import keys
from schemas.errors import CorruptArtifactError, DamagedArtifactError, NotReadyError
from schemas.manifest import Manifest
from service.errors import error_response
from service.state import Services

BEING_MADE_AGAIN = "A stored file of the mesh was damaged; it is being made again."


def download_path(store: Store, manifest: Manifest, name: str) -> Path:
    """The file of a download, compared with the sha256 in the record of its stage. Raises NotFoundError, DamagedArtifactError."""
    digest = next((stage.artifacts[name] for stage in manifest.stages if name in stage.artifacts), None)
    try:
        return store.compared_path(keys.artifact(manifest.id, name), digest)
    except CorruptArtifactError as error:
        raise DamagedArtifactError("a download's bytes have changed since it was written", file=name, mesh=manifest.id) from error


def install(app: FastAPI) -> None:
    """Have the app answer 409 where a file is damaged, once its stage is due again."""
    app.add_exception_handler(DamagedArtifactError, _on_damaged)


async def _on_damaged(request: Request, error: Exception) -> Response:
    assert isinstance(error, DamagedArtifactError)
    parts, mesh_id = cast(Services, request.app.state.services), error.where["mesh"]
    parts.assets.drop(mesh_id)
    await to_thread.run_sync(parts.queue.rebuild, mesh_id)
    return error_response(NotReadyError(BEING_MADE_AGAIN, mesh=mesh_id))
