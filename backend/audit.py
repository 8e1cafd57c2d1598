"""A complete pass over the store: what is found by no mark, since it was lost or an earlier version put none (`backend.unfinished`)."""

from __future__ import annotations

import logging
from collections.abc import Collection

from backend import records, unfinished
from backend.store import Store
from schemas import keys
from schemas.errors import CancelledError, DamagedArtifactError, DamagedUploadError
from schemas.jobs import LATER_STAGES

log = logging.getLogger(__name__)


def audit(store: Store, *, measure: bool) -> None:
    """Mark every unfinished mesh that has no mark; remove meshes and uploads without an acceptance record, left by interrupted calls.

    measure: whether a mesh that is ready has later stages to go through. No upload goes while there is an acceptance record that cannot
    be read: it may be that one's. One mesh takes a look at its names; its acceptance is read once in a process, its manifest where it has
    ended without later stages.
    """
    marked = {mesh_id for mesh_id, _ in unfinished.marked(store)}
    in_use = set()
    for mesh_id, found in records.outlines(store):
        if keys.ACCEPTED not in found:
            _remove_remains(store, mesh_id)
            continue
        if mesh_id not in marked and not _is_settled(store, mesh_id, found, measure=measure):
            _mark(store, mesh_id)
        try:
            in_use.add(records.upload_of(store, mesh_id))
        except DamagedUploadError:
            log.exception("unreadable acceptance record", extra={"mesh": mesh_id})
    for upload in set(store.children(keys.UPLOADS)) - in_use:
        with store.locked(keys.upload(upload)):
            if not records.is_used(store, upload):
                store.delete(keys.upload(upload))


def _remove_remains(store: Store, mesh_id: str) -> None:
    with store.locked(keys.accepted(mesh_id)):
        if not records.is_accepted(store, mesh_id):
            store.delete_prefix(keys.folder(mesh_id))


def _is_settled(store: Store, mesh_id: str, found: Collection[str], *, measure: bool) -> bool:
    """Whether a mesh, of which these records were found, has ended, and failed or been through the later stages."""
    if keys.MANIFEST not in found:
        return False
    if not measure or all(keys.stage_name(stage) in found for stage in LATER_STAGES):
        return True
    try:
        manifest = records.read_manifest(store, mesh_id)
    except DamagedArtifactError:
        return False
    return manifest is not None and manifest.status == "failed"


def _mark(store: Store, mesh_id: str) -> None:
    try:
        with records.publishing(store, mesh_id):
            unfinished.mark(store, mesh_id)
    except CancelledError:  # deleted meanwhile
        return
    log.warning("an unfinished mesh had no mark", extra={"mesh": mesh_id})
