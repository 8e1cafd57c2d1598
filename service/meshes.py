"""What the API says about meshes, put together from the records in the store and the progress in Redis."""

from __future__ import annotations

import heapq
from collections.abc import Iterator
from datetime import UTC, datetime, timedelta

from backend import records
from backend.manifests import read_drawable
from backend.progress import Progress
from backend.store import Store
from schemas.artifacts import COLOR_PNG, HULL_GLB, NORMAL_PNG
from schemas.errors import InvalidRequestError, NotFoundError, NotReadyError
from schemas.jobs import LATER_STAGES, STAGES
from schemas.keys import MESH_ID, MESHES
from schemas.manifest import Accepted, Manifest, StageRecord
from schemas.mesh import BoundingSphere, MeshInfo, MeshPage, MeshStatus, Problem, Stage, StageStatus
from service.errors import FailedMeshError

NO_SUCH_MESH = "There is no such mesh; it may have been deleted."
LAST_STAGE = list(LATER_STAGES)[-1]
MOST_SETTLED = 4096
"""Meshes whose manifests are kept, since nothing about them changes any more."""
EPOCH = datetime(1970, 1, 1, tzinfo=UTC)


class Meshes:
    """Reads meshes. Acceptance records never change, so they are kept; all calls do file or Redis I/O and block."""

    def __init__(self, store: Store, progress: Progress, *, measure: bool = False) -> None:
        self._store = store
        self._progress = progress
        self._measure = measure
        self._accepted: dict[str, Accepted] = {}
        self._settled: dict[str, Manifest] = {}

    def info(self, mesh_id: str) -> MeshInfo:
        """Everything about a mesh. Raises NotFoundError."""
        accepted = self._read_accepted(mesh_id)
        manifest = records.read_manifest(self._store, mesh_id)
        if manifest is None:
            return self._in_work(accepted)
        later = self._later(mesh_id) if manifest.status == "ready" else []
        info = _ended(accepted, manifest, later)
        if any(stage.name == LAST_STAGE and stage.status is StageStatus.DONE for stage in later):
            info.links["accuracy"] = f"/v1/meshes/{mesh_id}/accuracy"
        return info

    def manifest(self, mesh_id: str) -> Manifest:
        """The manifest of a mesh that is ready. Raises NotFoundError, NotReadyError, FailedMeshError."""
        self._read_accepted(mesh_id)
        manifest = records.read_manifest(self._store, mesh_id)
        if manifest is None:
            raise NotReadyError("The mesh is accepted, but its preprocessing has not ended.", mesh=mesh_id)
        if manifest.status == "failed":
            raise _failure(manifest)
        return manifest

    def drawable(self, mesh_id: str) -> Manifest:
        """What there is to draw of a mesh (`backend.manifests.read_drawable`). Raises NotFoundError, NotReadyError, FailedMeshError."""
        self._read_accepted(mesh_id)
        settled = self._settled.get(mesh_id)
        if settled is not None:
            return settled
        manifest = read_drawable(self._store, mesh_id)
        if manifest.status == "failed":
            raise _failure(manifest)
        if manifest.stages[-1].stage == LAST_STAGE:
            self._settled[mesh_id] = manifest
            while len(self._settled) > MOST_SETTLED:
                self._settled.pop(next(iter(self._settled)))
        return manifest

    def fault_of(self, mesh_id: str, stage: str) -> Problem | None:
        """Why a stage of a mesh failed, if it did."""
        record = records.read_stage(self._store, mesh_id, stage)
        return None if record is None or record.outcome != "failed" else record.error

    def page(self, limit: int, after: str | None) -> MeshPage:
        """The `limit` meshes behind the place `after` (a `next` of an earlier page), newest first. Raises InvalidRequestError."""
        behind = None if after is None else _parse_place(after)
        everything = (mesh for mesh in self._all() if behind is None or _place(mesh) < behind)
        newest = heapq.nlargest(limit + 1, everything, key=_place)
        infos = [info for mesh in newest[:limit] if (info := self._info_or_none(mesh.id))]
        more = len(newest) > limit
        return MeshPage(meshes=infos, next=f"/v1/meshes?limit={limit}&after={_place_text(newest[limit - 1])}" if more else None)

    def forget(self, mesh_id: str) -> None:
        """Drop what is kept of a mesh that is being deleted."""
        self._accepted.pop(mesh_id, None)
        self._settled.pop(mesh_id, None)

    def _all(self) -> Iterator[Accepted]:
        for mesh_id in self._store.children(MESHES):
            try:
                yield self._read_accepted(mesh_id)
            except NotFoundError:  # deleted meanwhile
                continue

    def _info_or_none(self, mesh_id: str) -> MeshInfo | None:
        try:
            return self.info(mesh_id)
        except NotFoundError:
            return None

    def _read_accepted(self, mesh_id: str) -> Accepted:
        if not MESH_ID.match(mesh_id) or not records.is_accepted(self._store, mesh_id):
            self.forget(mesh_id)
            raise NotFoundError(NO_SUCH_MESH)
        try:
            return self._accepted.get(mesh_id) or self._accepted.setdefault(mesh_id, records.read_accepted(self._store, mesh_id))
        except NotFoundError:
            raise NotFoundError(NO_SUCH_MESH) from None

    def _in_work(self, accepted: Accepted) -> MeshInfo:
        running = self._progress.read(accepted.id)
        ended = {stage: records.read_stage(self._store, accepted.id, stage) for stage in STAGES}
        stages = [_stage(name, ended[name], running.get(name)) for name in STAGES]
        started = any(stage.status is not StageStatus.QUEUED for stage in stages)
        status = MeshStatus.PROCESSING if started else MeshStatus.QUEUED
        loaded = ended["load"] is not None and ended["load"].outcome == "done"
        return MeshInfo(
            id=accepted.id,
            name=accepted.name,
            status=status,
            stages=stages,
            links=_links(accepted.id, None) | (_picture_links(accepted.id) if loaded else {}),
            created=accepted.created,
        )

    def _later(self, mesh_id: str) -> list[Stage]:
        """The later stages of a ready mesh, where this service wants them or they are done."""
        ended = {stage: records.read_stage(self._store, mesh_id, stage) for stage in LATER_STAGES}
        if not self._measure and not any(ended.values()):
            return []
        running = {} if all(ended.values()) else self._progress.read(mesh_id)
        return [_stage(name, record, running.get(name)) for name, record in ended.items()]


def _failure(manifest: Manifest) -> FailedMeshError:
    return FailedMeshError(manifest.error or Problem(title="Preprocessing failed", status=422, detail="The mesh could not be processed."))


def _ended(accepted: Accepted, manifest: Manifest, later: list[Stage]) -> MeshInfo:
    by_name = {record.stage: record for record in manifest.stages}
    return MeshInfo(
        id=accepted.id,
        name=accepted.name,
        status=MeshStatus(manifest.status),
        stages=[
            _stage(name, by_name.get(name), None) if name in by_name else Stage(name=name, status=StageStatus.SKIPPED) for name in STAGES
        ]
        + later,
        stats=manifest.stats,
        sphere=BoundingSphere(centre=manifest.frame.centre, radius=manifest.frame.scale) if manifest.frame else None,
        capabilities=manifest.capabilities,
        hull=manifest.hull,
        repairs=manifest.repairs,
        error=manifest.error,
        links=_links(accepted.id, manifest),
        created=accepted.created,
    )


def _stage(name: str, record: StageRecord | None, running: float | None) -> Stage:
    if record is not None:
        return Stage(name=name, status=StageStatus(record.outcome), progress=1.0, seconds=record.seconds, error=record.error)
    if running is not None:
        return Stage(name=name, status=StageStatus.RUNNING, progress=running)
    return Stage(name=name)


def _links(mesh_id: str, manifest: Manifest | None) -> dict[str, str]:
    """Addresses of what there is: of a mesh that is ready, and only of downloads that were made."""
    base = f"/v1/meshes/{mesh_id}"
    links = {"self": base, "events": f"{base}/events"}
    if manifest is None or manifest.status != "ready":
        return links
    links |= _picture_links(mesh_id)
    if (clip := manifest.capabilities.get("clip")) is not None and clip.available:
        links["silhouette"] = f"{base}/silhouette.svg"
    made = {name for record in manifest.stages for name in record.artifacts}
    return links | {name: f"{base}/artifacts/{name}" for name in (HULL_GLB, NORMAL_PNG, COLOR_PNG) if name in made}


def _picture_links(mesh_id: str) -> dict[str, str]:
    base = f"/v1/meshes/{mesh_id}"
    return {"render": f"{base}/render.png", "thumbnail": f"{base}/thumbnail.png"}


def _place(mesh: Accepted) -> tuple[int, str]:
    """Where a mesh stands in the order of a listing: microseconds since 1970, then its id."""
    created = mesh.created if mesh.created.tzinfo else mesh.created.replace(tzinfo=UTC)
    return (created - EPOCH) // timedelta(microseconds=1), mesh.id


def _place_text(mesh: Accepted) -> str:
    return "{}-{}".format(*_place(mesh))


def _parse_place(text: str) -> tuple[int, str]:
    microseconds, _, mesh_id = text.partition("-")
    if not (microseconds.isdecimal() and len(microseconds) < 20 and MESH_ID.match(mesh_id)):
        raise InvalidRequestError("after must be taken from the next link of an earlier page.", field="after")
    return int(microseconds), mesh_id
