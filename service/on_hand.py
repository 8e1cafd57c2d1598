"""What is drawn: at once where it is at hand, and by a thread where the store has to be asked."""

from __future__ import annotations

from anyio import to_thread
from fastapi import Request

from schemas.manifest import Manifest
from service.assets import MeshAsset
from service.state import Services
from service.waiting import wait_for


async def manifest_of(parts: Services, mesh_id: str) -> Manifest:
    """`Meshes.drawable`, which see for what is raised."""
    recent = parts.meshes.recent(mesh_id)
    return await to_thread.run_sync(parts.meshes.drawable, mesh_id) if recent is None else recent


async def asset_of(request: Request, parts: Services, manifest: Manifest) -> MeshAsset:
    """`AssetCache.get` for a request. Raises what that and `wait_for` raise."""
    held = parts.assets.held(manifest)
    if held is not None:
        return held
    return await wait_for(request, parts.cpu.submit(parts.assets.get, manifest), parts.settings.render_timeout_s)
