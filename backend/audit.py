"""A complete pass over the store: what is found by no mark and no use, since they were lost or an earlier version put none.

Marks: `backend.unfinished`. Uses, `uses/<sha256>/<mesh id>`, say by which meshes an upload is used; `records.accept` puts one before the
acceptance, `records.forget` removes it. One that is missing could cost an upload that another mesh has, one too many keeps it for nothing.
"""

from __future__ import annotations

import logging
from collections.abc import Collection

from backend import records, unfinished
from backend.store import Store
from schemas import keys
from schemas.errors import CancelledError, DamagedArtifactError, DamagedUploadError, NotFoundError
from schemas.jobs import LATER_STAGES

log = logging.getLogger(__name__)


def audit(store: Store, *, measure: bool) -> None:
    """Mark every unfinished mesh that has no mark, put and remove uses; remove what has no acceptance: meshes and uploads, left by
    interrupted calls.

    measure: whether a mesh that is ready has later stages to go through. No upload goes while there is a mesh without a use whose
    acceptance cannot be read: it may be that one's. What is listed is everything; acceptances are read of meshes without a use, manifests
    of those that have ended without later stages.
    """
    marked = {mesh_id for mesh_id, _ in unfinished.marked(store)}
    uses, unknown = _uses(store)
    in_use = set()
    for mesh_id, found in records.outlines(store):
        if keys.ACCEPTED not in found:
            _remove_remains(store, mesh_id)
            continue
        if mesh_id not in marked and not _is_settled(store, mesh_id, found, measure=measure):
            _mark(store, mesh_id)
        if (upload := uses.pop(mesh_id, None)) is None or mesh_id in unknown:
            upload = _put_use(store, mesh_id)
        if upload is not None:
            in_use.add(upload)
    for mesh_id, upload in [*uses.items(), *((mesh_id, keys.UNKNOWN_UPLOAD) for mesh_id in unknown)]:
        _remove_use(store, mesh_id, upload)
    store.put_bytes(keys.USES_COMPLETE, b"", create_only=True)
    for upload in set(store.children(keys.UPLOADS)) - in_use:
        with store.locked(keys.upload(upload)):
            if not records.is_used(store, upload):
                store.delete(keys.upload(upload))


def _uses(store: Store) -> tuple[dict[str, str], set[str]]:
    """(mesh id -> sha256 of its upload, ids of meshes whose acceptance could not be read) of all uses."""
    known: dict[str, str] = {}
    unknown = set()
    for key in store.list(keys.USES):
        upload, mesh_id = key.removeprefix(keys.USES).split("/")
        if upload == keys.UNKNOWN_UPLOAD:
            unknown.add(mesh_id)
        else:
            known[mesh_id] = upload
    return known, unknown


def _put_use(store: Store, mesh_id: str) -> str | None:
    """Put the missing use of a mesh; the sha256 of its upload, or None where it is deleted or its acceptance cannot be read."""
    try:
        upload = records.read_accepted(store, mesh_id).upload_sha256
    except NotFoundError:
        return None
    except DamagedUploadError:
        log.exception("unreadable acceptance record", extra={"mesh": mesh_id})
        upload = keys.UNKNOWN_UPLOAD
    try:
        with store.locked(keys.upload(upload)), records.publishing(store, mesh_id):
            store.put_bytes(keys.use(upload, mesh_id), b"")
            if upload != keys.UNKNOWN_UPLOAD:
                store.delete(keys.use(keys.UNKNOWN_UPLOAD, mesh_id))
    except CancelledError:  # deleted meanwhile
        return None
    return upload


def _remove_use(store: Store, mesh_id: str, upload: str) -> None:
    """Remove the use of a mesh that is not accepted, or was not when it was looked for."""
    with store.locked(keys.upload(upload)), store.locked(keys.accepted(mesh_id)):
        if not records.is_accepted(store, mesh_id):
            store.delete(keys.use(upload, mesh_id))


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
