"""Files of a mesh that are not as they were written: which stages made them, and how those come to run again."""

from __future__ import annotations

import hashlib
import logging
from pathlib import Path

from backend import records, unfinished
from backend.artifacts import open_artifact, read_header
from backend.store import Store
from schemas import keys
from schemas.artifacts import LAYOUTS, Layout
from schemas.errors import CorruptArtifactError, NotFoundError
from schemas.jobs import LATER_STAGES, STAGES
from schemas.manifest import StageRecord

log = logging.getLogger(__name__)

LAYOUT_OF = {layout.file: layout for layout in LAYOUTS}


def drop_damaged(store: Store, mesh_id: str) -> list[str]:
    """Forget the stages of a mesh whose files are damaged or missing, so that they are due again; their names.

    The files of all stages are read. What other stages made of the sound files stays: a stage writes the same bytes whenever it runs.
    `verify` runs again with any other, and the manifest goes first, so that whoever dies half-way leaves a mesh that is in work. A damaged
    manifest goes, too: it is made of the records.
    Raises CancelledError when the mesh has been deleted, StorageFullError when there is no room to mark it; then it stays as it is.
    """
    with records.publishing(store, mesh_id):
        records.drop_damaged_manifest(store, mesh_id)
        ended = (records.read_stage(store, mesh_id, stage) for stage in (*STAGES, *LATER_STAGES))
        damaged = [record.stage for record in ended if record is not None and not is_sound(store, mesh_id, record)]
        if damaged:
            unfinished.mark(store, mesh_id)
        if any(stage in STAGES for stage in damaged):
            store.delete(keys.manifest(mesh_id))
            damaged.append("verify")
        elif damaged:  # the same manifest anew: who keeps what is known of the mesh by the manifest's version looks again
            store.put_bytes(keys.manifest(mesh_id), store.get_bytes(keys.manifest(mesh_id)))
        for stage in damaged:
            store.delete(keys.stage_record(mesh_id, stage))
    if damaged:
        log.error("damaged files: stages run again", extra={"mesh": mesh_id, "stages": damaged})
    return damaged


def is_sound(store: Store, mesh_id: str, record: StageRecord) -> bool:
    """Whether all files of a stage have the contents whose hashes its record has."""
    return all(contents_sha256(store, mesh_id, name) == digest for name, digest in record.artifacts.items())


def contents_sha256(store: Store, mesh_id: str, name: str) -> str | None:
    """The hash that the record of a sound file has, hex; None for an artifact that is damaged, and for any file that is missing."""
    try:
        if name not in LAYOUT_OF:
            return hashlib.sha256(store.get_bytes(keys.artifact(mesh_id, name))).hexdigest()
        return store.read_local(keys.artifact(mesh_id, name), lambda path: _artifact_sha256(path, LAYOUT_OF[name]))
    except (NotFoundError, CorruptArtifactError):
        return None


def _artifact_sha256(path: Path, layout: Layout) -> str:
    open_artifact(path, layout, verify=True)
    return read_header(path, layout).sha256
