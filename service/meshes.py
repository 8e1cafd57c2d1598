"""What the API says about meshes, put together from the records in the store and the progress in Redis."""

from __future__ import annotations

import heapq
import threading
import time
from collections import OrderedDict
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from datetime import UTC, datetime, timedelta
from typing import TypeVar

from backend import records
from backend.manifests import loaded_manifest, with_later_stages
from backend.problems import problem_of
from backend.progress import Progress
from backend.store import Store
from schemas import keys
from schemas.artifacts import COLOR_PNG, HULL_GLB, NORMAL_PNG, ORIGINAL_GLB
from schemas.errors import DamagedUploadError, InvalidRequestError, NotFoundError, NotReadyError
from schemas.jobs import LATER_STAGES, STAGES
from schemas.keys import MESH_ID, MESHES
from schemas.manifest import Accepted, Manifest, StageRecord
from schemas.mesh import BoundingSphere, MeshInfo, MeshPage, MeshStatus, Problem, Stage, StageStatus
from service.assets import READY
from service.errors import FailedMeshError

NO_SUCH_MESH = "There is no such mesh; it may have been deleted."
NOT_READY = "The mesh is accepted, but its preprocessing has not ended."
KEPT = 256
"""Manifests in memory: with what was measured one takes some hundred KiB."""

ACCEPTED_KEPT = 4096
"""Acceptance records in memory: one takes 2 KiB."""

RECENT_S = 0.1
"""Between two looks at a mesh that is drawn again and again: a thread has to be woken for each."""

READ_AT_ONCE = 16
"""Meshes of a page that are read side by side."""

T = TypeVar("T")

EPOCH = datetime(1970, 1, 1, tzinfo=UTC)


class Meshes:
    """Reads meshes; all calls do file or Redis I/O and block. Thread-safe.

    Acceptance records never change, so those that were asked for last are kept; so are the manifests of meshes that no stage is to be run
    for any more, as long as their files are the same. Where a look at the store takes milliseconds, a mesh that is ready is looked up every
    `Store.look_interval_s` only, and by `recent` nowhere more often than every RECENT_S: so much later a process sees that another has
    deleted it. `measure`: whether ready meshes go through the later stages here.
    """

    def __init__(self, store: Store, progress: Progress, *, measure: bool) -> None:
        self._store = store
        self._progress = progress
        self._measure = measure
        self._accepted: OrderedDict[str, Accepted] = OrderedDict()
        self._settled: OrderedDict[str, tuple[str, Manifest]] = OrderedDict()
        self._seen: OrderedDict[str, tuple[float, Manifest]] = OrderedDict()
        self._forgotten = 0  # so often
        self._lock = threading.Lock()

    def info(self, mesh_id: str) -> MeshInfo:
        """Everything about a mesh. Raises NotFoundError, FailedMeshError when its acceptance is damaged."""
        accepted = self._read_accepted(mesh_id)
        manifest = self._current(mesh_id)
        return self._in_work(accepted, manifest) if manifest is None or manifest.status == "loaded" else self._ended(accepted, manifest)

    def manifest(self, mesh_id: str) -> Manifest:
        """The manifest of a mesh that is ready, as `drawable`. Raises NotFoundError, NotReadyError, FailedMeshError."""
        manifest = self.drawable(mesh_id)
        if manifest.status != READY:
            raise NotReadyError(NOT_READY, mesh=mesh_id)
        return manifest

    def drawable(self, mesh_id: str) -> Manifest:
        """What can be drawn of a mesh: its manifest, with the later stages that have ended, or before that what load found.

        Raises NotFoundError, NotReadyError, FailedMeshError.
        """
        if (seen := self._seen_within(mesh_id, self._store.look_interval_s)) is not None:
            return seen
        started_s, forgotten = time.monotonic(), self._forgotten
        self._require(mesh_id)
        manifest = self._current(mesh_id)
        if manifest is None:
            raise NotReadyError(NOT_READY, mesh=mesh_id)
        if manifest.status == "failed":
            raise FailedMeshError(
                manifest.error or Problem(title="Preprocessing failed", status=422, detail="The mesh could not be processed.")
            )
        if manifest.status == READY:
            with self._lock:
                if forgotten == self._forgotten:  # else it may be this one that was deleted since
                    _put(self._seen, mesh_id, (started_s, manifest))
        return manifest

    def recent(self, mesh_id: str) -> Manifest | None:
        """What `drawable` found ready a moment ago, without a look at the store: does not block."""
        return self._seen_within(mesh_id, max(self._store.look_interval_s, RECENT_S))

    def _seen_within(self, mesh_id: str, seconds: float) -> Manifest | None:
        with self._lock:
            looked_s, seen = self._seen.get(mesh_id, (0.0, None))
        return seen if time.monotonic() - looked_s < seconds else None

    def page(self, limit: int, after: str | None) -> MeshPage:
        """The `limit` meshes behind the place `after` (a `next` of an earlier page), newest first. Raises InvalidRequestError."""
        behind = None if after is None else _parse_place(after)
        everything = (mesh for mesh in self._each(self._known, self._store.children(MESHES)) if behind is None or _place(mesh) < behind)
        newest = heapq.nlargest(limit + 1, everything, key=_place)
        infos = list(self._each(self.info, (mesh.id for mesh in newest[:limit])))
        more = len(newest) > limit
        return MeshPage(meshes=infos, next=f"/v1/meshes?limit={limit}&after={_place_text(newest[limit - 1])}" if more else None)

    def forget(self, mesh_id: str) -> None:
        """Drop what is kept of a mesh that is being deleted."""
        with self._lock:
            self._forgotten += 1
            self._accepted.pop(mesh_id, None)
            self._settled.pop(mesh_id, None)
            self._seen.pop(mesh_id, None)

    def _current(self, mesh_id: str) -> Manifest | None:
        """How far a mesh is, failed ones included; None while it is not even loaded."""
        version = self._store.version(keys.manifest(mesh_id))
        if version is None:
            load = records.read_stage(self._store, mesh_id, "load")
            return loaded_manifest(mesh_id, load) if load is not None and load.outcome == "done" else None
        with self._lock:
            kept_version, kept = self._settled.get(mesh_id, (None, None))
            if kept is not None and kept_version == version:
                self._settled.move_to_end(mesh_id)
                return kept
        # before they are read: what lands meanwhile is seen the next time
        settled = not self._measure or all(self._store.exists(keys.stage_record(mesh_id, stage)) for stage in LATER_STAGES)
        manifest = records.read_manifest(self._store, mesh_id)
        if manifest is None:  # deleted meanwhile
            return None
        if manifest.status == READY:
            manifest = with_later_stages(self._store, manifest)
        if settled or manifest.status == "failed":
            self._keep(mesh_id, version, manifest)
        return manifest

    def _keep(self, mesh_id: str, version: str, manifest: Manifest) -> None:
        with self._lock:
            _put(self._settled, mesh_id, (version, manifest))

    def _each(self, read: Callable[[str], T], ids: Iterable[str]) -> Iterator[T]:
        """What is read of each mesh that is not deleted meanwhile and whose acceptance is sound; several at a time where reading takes
        milliseconds."""

        def found(mesh_id: str) -> T | None:
            try:
                return read(mesh_id)
            except (NotFoundError, FailedMeshError):
                return None

        if not self._store.look_interval_s:
            return (one for one in map(found, ids) if one is not None)
        with ThreadPoolExecutor(READ_AT_ONCE) as pool:
            return (one for one in list(pool.map(found, ids)) if one is not None)

    def _known(self, mesh_id: str) -> Accepted:
        """The acceptance of a mesh that was accepted once. Raises NotFoundError."""
        return self._kept_accepted(mesh_id) or self._read_accepted(mesh_id)

    def _kept_accepted(self, mesh_id: str) -> Accepted | None:
        with self._lock:
            if mesh_id in self._accepted:
                self._accepted.move_to_end(mesh_id)
            return self._accepted.get(mesh_id)

    def _require(self, mesh_id: str) -> None:
        """Raise NotFoundError when there is no such mesh."""
        if not MESH_ID.match(mesh_id) or not records.is_accepted(self._store, mesh_id):
            self.forget(mesh_id)
            raise NotFoundError(NO_SUCH_MESH)

    def _read_accepted(self, mesh_id: str) -> Accepted:
        """The acceptance of a mesh. Raises NotFoundError, FailedMeshError when it is damaged."""
        self._require(mesh_id)
        if (kept := self._kept_accepted(mesh_id)) is not None:
            return kept
        try:
            accepted = records.read_accepted(self._store, mesh_id)
        except NotFoundError:
            raise NotFoundError(NO_SUCH_MESH) from None
        except DamagedUploadError as error:
            raise FailedMeshError(problem_of(error)) from error
        with self._lock:
            _put(self._accepted, mesh_id, accepted, ACCEPTED_KEPT)
        return accepted

    def _in_work(self, accepted: Accepted, loaded: Manifest | None) -> MeshInfo:
        running = self._progress.read(accepted.id)
        ended = {stage: records.read_stage(self._store, accepted.id, stage) for stage in STAGES}
        stages = [_stage(name, ended[name], running.get(name)) for name in STAGES]
        started = any(stage.status is not StageStatus.QUEUED for stage in stages)
        later = [Stage(name=name) for name in LATER_STAGES if self._measure]
        return _info(accepted, MeshStatus.PROCESSING if started else MeshStatus.QUEUED, [*stages, *later], loaded)

    def _ended(self, accepted: Accepted, manifest: Manifest) -> MeshInfo:
        by_name = {record.stage: record for record in manifest.stages}
        stages = [_stage(name, by_name[name], None) if name in by_name else Stage(name=name, status=StageStatus.SKIPPED) for name in STAGES]
        if manifest.status == READY:
            unended = self._measure and not by_name.keys() >= LATER_STAGES.keys()
            running = self._progress.read(accepted.id) if unended else {}
            later = LATER_STAGES if self._measure else [name for name in LATER_STAGES if name in by_name]
            stages += [_stage(name, by_name.get(name), running.get(name)) for name in later]
        return _info(accepted, MeshStatus(manifest.status), stages, manifest)


def _put(kept: OrderedDict[str, T], mesh_id: str, value: T, most: int = KEPT) -> None:
    """Keep a value, and of all the latest ones."""
    kept[mesh_id] = value
    kept.move_to_end(mesh_id)
    while len(kept) > most:
        kept.popitem(last=False)


def _info(accepted: Accepted, status: MeshStatus, stages: list[Stage], manifest: Manifest | None) -> MeshInfo:
    known = {} if manifest is None else {name: getattr(manifest, name) for name in ("stats", "capabilities", "hull", "repairs", "error")}
    frame = None if manifest is None else manifest.frame
    return MeshInfo(
        id=accepted.id,
        name=accepted.name,
        status=status,
        stages=stages,
        sphere=BoundingSphere(centre=frame.centre, radius=frame.scale) if frame else None,
        links=_links(accepted.id, manifest),
        created=accepted.created,
        **known,
    )


def _stage(name: str, record: StageRecord | None, running: float | None) -> Stage:
    if record is not None:
        return Stage(name=name, status=StageStatus(record.outcome), progress=1.0, seconds=record.seconds, error=record.error)
    if running is not None:
        return Stage(name=name, status=StageStatus.RUNNING, progress=running)
    return Stage(name=name)


def _links(mesh_id: str, manifest: Manifest | None) -> dict[str, str]:
    """Addresses of what there is: pictures as soon as the mesh is loaded, downloads only those that were made."""
    base = f"/v1/meshes/{mesh_id}"
    links = {"self": base, "events": f"{base}/events"}
    if manifest is None or manifest.status == "failed":
        return links
    links |= {"render": f"{base}/render.png", "thumbnail": f"{base}/thumbnail.png", ORIGINAL_GLB: f"{base}/artifacts/{ORIGINAL_GLB}"}
    if (clip := manifest.capabilities.get("clip")) is not None and clip.available:
        links["silhouette"] = f"{base}/silhouette.svg"
    if any(record.stage == "measure" and record.outcome == "done" for record in manifest.stages):
        links["accuracy"] = f"{base}/accuracy"
    made = {name for record in manifest.stages for name in record.artifacts}
    return links | {name: f"{base}/artifacts/{name}" for name in (HULL_GLB, NORMAL_PNG, COLOR_PNG) if name in made}


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
