"""The stage `measure`: a mesh's ladder, in steps that can be interrupted."""

from __future__ import annotations

import json
import logging
from collections.abc import Callable
from typing import Any

from pydantic import BaseModel, ValidationError

from backend import records
from backend.manifests import read_drawable
from backend.store import Store
from schemas import keys
from schemas.errors import NotFoundError, StageFailedError
from schemas.ladder import SAMPLES
from service.assets import MeshAsset, load_asset
from service.measure.ladder import Measured, measure_step, put_together, steps
from service.render.context import EglUnavailableError
from service.render.state import Gpu

log = logging.getLogger("silhouette.measure")
STAGE = "measure"
CACHE_MIB = 512


class Partial(BaseModel):
    """What has been measured before an interruption. device, rungs: of what; another device or other rungs begin anew."""

    device: str
    rungs: list[str]
    samples: int
    measured: list[Measured] = []


def measure_mesh(store: Store, mesh_id: str, progress: Callable[[float], None], pause: Callable[[], bool]) -> dict[str, Any] | None:
    """The ladder of a mesh as JSON, or None when `pause` stopped it; what it had is kept, and goes on where it stopped.

    progress takes 0..1 between steps and may raise. Raises NotReadyError, CorruptArtifactError, StageFailedError where nothing can be
    drawn on this machine, CancelledError when the mesh is deleted meanwhile.
    """
    asset = load_asset(store, read_drawable(store, mesh_id))
    try:
        gpu = Gpu(CACHE_MIB)
    except EglUnavailableError as error:
        raise StageFailedError(f"accuracy cannot be measured here: {error}") from error
    try:
        return _measured(store, mesh_id, asset, gpu, progress, pause)
    finally:
        gpu.release()


def _measured(
    store: Store, mesh_id: str, asset: MeshAsset, gpu: Gpu, progress: Callable[[float], None], pause: Callable[[], bool]
) -> dict[str, Any] | None:
    partial = _read_partial(
        store, mesh_id, Partial(device=gpu.costs.device, rungs=[key.label for key in asset.rungs.keys], samples=SAMPLES)
    )
    todo = steps()
    done = {(one.size, one.view) for one in partial.measured}
    for step in todo:
        if step in done:
            continue
        progress(len(partial.measured) / len(todo))
        if pause():
            log.info("paused: others are waiting", extra={"mesh": mesh_id, "done": len(partial.measured)})
            return None
        partial.measured.append(measure_step(gpu, asset, step))
        with records.publishing(store, mesh_id):
            store.put_bytes(keys.partial(mesh_id, STAGE), partial.model_dump_json().encode())
    return put_together(asset, partial.device, partial.measured).model_dump(mode="json")


def _read_partial(store: Store, mesh_id: str, fresh: Partial) -> Partial:
    """What an earlier run left, when it is of the same rungs on the same device; otherwise nothing."""
    try:
        found = Partial.model_validate(json.loads(store.get_bytes(keys.partial(mesh_id, STAGE))))
    except (NotFoundError, ValidationError, ValueError):
        return fresh
    same = (found.device, found.rungs, found.samples) == (fresh.device, fresh.rungs, fresh.samples)
    return found if same else fresh
