"""The stage `measure`: a mesh's ladder, in steps that can be interrupted."""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from typing import Any

from pydantic import BaseModel, ValidationError

from backend import records
from backend.manifests import with_later_stages
from backend.store import Store
from schemas import keys
from schemas.errors import NotFoundError, NotReadyError, StageFailedError
from schemas.ladder import SAMPLES, SIZES, VIEWS, Ladder, RungKey
from schemas.manifest import Manifest
from service.assets import MeshAsset, load_asset
from service.measure.ladder import Measured, Step, is_whole, measure_step, put_together, steps
from service.render.context import PACKAGES, EglUnavailableError
from service.render.state import Gpu

log = logging.getLogger("silhouette.measure")
STAGE = "measure"
VERSION = 1
"""Of what is kept of a view and how that is measured: raise it when old and new must not mix."""
CACHE_MIB = 512
"""Of surfaces: the mesh and all of its hulls, between their turns."""


class Partial(BaseModel):
    """What has been measured before an interruption, and of what: anything else begins anew."""

    version: int = VERSION
    device: str
    keys: tuple[RungKey, ...]
    views: int
    samples: int = SAMPLES
    measured: list[Measured] = []


def measure_mesh(store: Store, mesh_id: str, progress: Callable[[float], None], pause: Callable[[], bool]) -> dict[str, Any] | None:
    """The ladder of a mesh as JSON, or None when `pause` stopped it; what it had is kept, and goes on where it stopped.

    It makes a GL context: the process has none and does not fork afterwards. progress takes 0..1 between steps and may raise. Raises
    NotReadyError, DamagedArtifactError, StageFailedError where nothing can be drawn on this machine, StorageFullError, CancelledError
    when the mesh is deleted meanwhile.
    """
    asset = load_asset(store, _ready(store, mesh_id))
    try:
        gpu = Gpu(CACHE_MIB)
    except EglUnavailableError as error:
        message = f"This machine cannot draw, so nothing was measured. A software renderer comes with: apt-get install {PACKAGES}"
        raise StageFailedError(message, code="no-renderer") from error
    try:
        ladder = measure(store, mesh_id, asset, gpu, progress, pause)
    finally:
        gpu.release()
    return None if ladder is None else ladder.model_dump(mode="json")


def _ready(store: Store, mesh_id: str) -> Manifest:
    """The manifest of a mesh that is ready, with the later stages that have ended."""
    manifest = records.read_manifest(store, mesh_id)
    if manifest is None:
        raise NotReadyError("the mesh is not ready", mesh=mesh_id)
    return with_later_stages(store, manifest)


def measure(
    store: Store,
    mesh_id: str,
    asset: MeshAsset,
    gpu: Gpu,
    progress: Callable[[float], None],
    pause: Callable[[], bool],
    views: int = VIEWS,
    sizes: Sequence[int] = SIZES,
) -> Ladder | None:
    """The same with a GL that there is, in so many views and pictures of these sizes."""
    todo, warmed = steps(views, sizes), set[int]()
    partial = _read_partial(store, mesh_id, Partial(device=gpu.costs.device, keys=asset.rungs.keys, views=views), asset, todo)
    for done in range(len(partial.measured), len(todo)):
        progress(done / len(todo))
        if pause():
            log.info("paused: others are waiting", extra={"mesh": mesh_id, "done": done})
            return None
        step = todo[done]
        partial.measured.append(measure_step(gpu, asset, step, views, first=step.size not in warmed))
        warmed.add(step.size)
        with records.publishing(store, mesh_id):
            store.put_bytes(keys.partial(mesh_id, STAGE), partial.model_dump_json().encode())
    return put_together(asset, partial.device, partial.measured, views)


def _read_partial(store: Store, mesh_id: str, fresh: Partial, asset: MeshAsset, todo: list[Step]) -> Partial:
    """What an earlier run left, when it is whole, and of the same rungs on the same device; otherwise nothing."""
    try:
        found = Partial.model_validate_json(store.get_bytes(keys.partial(mesh_id, STAGE)))
    except NotFoundError:
        return fresh
    except ValidationError:
        log.warning("what was measured so far is damaged: begun anew", extra={"mesh": mesh_id})
        return fresh
    same = found == fresh.model_copy(update={"measured": found.measured})
    in_order = [Step(one.size, one.view) for one in found.measured] == todo[: len(found.measured)]
    return found if same and in_order and all(is_whole(one, asset) for one in found.measured) else fresh
