"""Meshes of one request: read by a reader, drawn or described from where it left them, and forgotten."""

from __future__ import annotations

from collections.abc import AsyncIterator, Collection
from contextlib import asynccontextmanager
from dataclasses import dataclass
from pathlib import Path

import redis
from anyio import CancelScope, to_thread
from fastapi import Request

from backend import once
from backend.manifests import NOT_ENDED, loaded_manifest
from schemas.errors import BusyError
from schemas.manifest import Manifest, StageRecord
from schemas.mesh import Capability
from service.access.caller import caller_of
from service.assets import CLIP, MeshAsset, load_asset
from service.errors import FailedMeshError
from service.state import Services
from service.uploads import Upload, receive_upload
from service.waiting import Stopwatch, wait_for, wait_until

LOOKS = 0.1
"""Of the time between two looks at what seldom changes, the part between two at a mesh that a client waits for."""
NOT_PREPARED = "a mesh that is not kept is not prepared for clipping: upload it to /v1/meshes for that"


@dataclass(frozen=True)
class OneMesh:
    """A mesh that lasts as long as its request. load_ms: from its last byte to here, reading and repairing included."""

    asset: MeshAsset
    upload: Upload
    load_ms: float


@asynccontextmanager
async def mesh_of(request: Request, parts: Services, beside: Collection[str]) -> AsyncIterator[OneMesh]:
    """The mesh in the body of a request, as a file or a form; nothing of it is left behind.

    beside: as in `receive_upload`. Raises what that raises, FailedMeshError for a mesh that cannot be used, BusyError, ClientDisconnect.
    """
    store, limit_s = parts.once, parts.settings.once_timeout_s
    with store.temporary() as file:
        upload = await receive_upload(request, file, parts.upload_limits.of(caller_of(request)), beside)
        clock = Stopwatch()
        token = await to_thread.run_sync(once.put, store, Path(file.name))
    try:
        try:
            await to_thread.run_sync(parts.queue.read_once, token, upload.extension, upload.options.model_dump(mode="json"), limit_s)
        except redis.RedisError as error:
            raise BusyError("The queue does not answer; try again in a moment.") from error
        record = await wait_until(request, lambda: once.answer(store, token), limit_s, store.look_interval_s * LOOKS)
        manifest = manifest_of(token, record)
        asset = await wait_for(request, parts.cpu.submit(load_asset, store, manifest), limit_s)
        yield OneMesh(asset, upload, clock.ms())
    finally:
        with CancelScope(shield=True):
            await to_thread.run_sync(once.forget, store, token)


def manifest_of(token: str, record: StageRecord) -> Manifest:
    """What can be drawn. Raises FailedMeshError."""
    if record.outcome != "done":
        assert record.error is not None
        raise FailedMeshError(record.error)
    manifest = loaded_manifest(token, record)
    clip = manifest.capabilities.get(CLIP)
    if clip is None or clip.reason == NOT_ENDED:
        manifest.capabilities[CLIP] = Capability(available=False, reason=NOT_PREPARED)
    return manifest
