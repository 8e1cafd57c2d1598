"""What a running service holds; made once by `service.app`, handed to every route."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, cast

import redis
from fastapi import Depends, Request

from backend.queue import JobQueue
from backend.store import Store
from service.access.policy import Access
from service.assets import AssetCache
from service.meshes import Meshes
from service.picture_cache import PictureCache
from service.readiness import Readiness
from service.render.renderer import Renderer
from service.settings import ServiceSettings
from service.slots import Slots
from service.uploads import UploadLimits


@dataclass(frozen=True)
class Services:
    """The parts that routes work with. `cpu` runs what would hold up the event loop, and pictures wait for: mapping artifacts, encoding;
    `documents` what may take long: silhouettes, drawings, files, animations.

    once: the store of meshes that are not kept (`backend.once`). access: who may do what. renderer_fault: why the renderer did not start,
    for people; None when it draws. probe: the queue's Redis, for those who ask how it is and do not wait long.
    """

    settings: ServiceSettings
    store: Store
    once: Store
    queue: JobQueue
    probe: redis.Redis
    meshes: Meshes
    assets: AssetCache
    renderer: Renderer
    pictures: PictureCache
    cpu: Slots
    documents: Slots
    access: Access
    readiness: Readiness
    renderer_fault: str | None

    @property
    def upload_limits(self) -> UploadLimits:
        """What an upload that comes now may take."""
        room = self.store.free_bytes() - self.settings.keep_free_mib * 2**20
        return UploadLimits(self.settings.max_upload_mib * 2**20, room)


def services_of(request: Request) -> Services:
    """The parts of the service that a request came to."""
    return cast(Services, request.app.state.services)


Parts = Annotated[Services, Depends(services_of)]
"""Parameter type of a route that needs the parts."""
