"""Reading and writing the records that make the store the truth (`schemas.manifest`).

Two locks keep acceptance, publication and deletion apart, always taken in this order: the upload's, then the mesh's.
After `forget` nothing of a mesh can be written any more, unless it is accepted again. What is in hand is marked (`backend.unfinished`).

On many machines a lock is a lease (`backend.leases`), and a process that was stopped at the wrong moment may write one thing after it
has lost it. What each such write can do:

accept   puts an upload under the hash of its bytes, and a record only where there is none that can be read: never anything wrong. A
         failure that came of damage it forgets; done late, that runs a stage once more.
publish  puts artifacts whose bytes follow from the mesh's id, and a manifest only where there is none. Of a mesh that is accepted they
         are right, whoever writes them; of one that was deleted meanwhile nobody looks at them, `accept` clears them away before the
         mesh is accepted again, and `audit` some day.
forget   deletes the acceptance first: done late, that is a deletion whose caller has not been answered yet. Done late, deleting what
         is behind it could take artifacts, or the upload, from a mesh that was accepted anew meanwhile; nothing is published of it that
         is not whole, but it may fail and have to be uploaded again. So every batch of deletions looks at the lease first.
"""

from __future__ import annotations

import logging
from collections.abc import Collection, Iterator
from contextlib import contextmanager, nullcontext, suppress
from itertools import chain
from pathlib import Path
from typing import TypeVar

from pydantic import BaseModel, ValidationError

from backend import unfinished
from backend.store import Store
from schemas import keys
from schemas.errors import (
    CancelledError,
    CorruptArtifactError,
    DamagedArtifactError,
    DamagedUploadError,
    NotFoundError,
    StorageFullError,
)
from schemas.jobs import LATER_STAGES, STAGES
from schemas.manifest import Accepted, Manifest, StageRecord

log = logging.getLogger(__name__)
OUTLINE = frozenset({keys.ACCEPTED, keys.MANIFEST, *map(keys.stage_name, LATER_STAGES)})

DAMAGED_BYTES = "The stored upload is damaged: send the same file with the same options again."
DAMAGED_RECORD = "The record of this upload is damaged: send the same file with the same options again."

R = TypeVar("R", bound=BaseModel)


def accept(store: Store, accepted: Accepted, upload: Path) -> bool:
    """Make an upload durable: its bytes (the file `upload`, moved away), then its record. False when it was accepted before.

    What is stored of it already is read: damaged bytes or a damaged record are replaced, and a mesh that failed by them is in work again;
    then True. Raises StorageFullError; then nothing is accepted.
    """
    with store.locked(keys.upload(accepted.upload_sha256)):
        try:
            upload_path(store, accepted.upload_sha256)
        except DamagedUploadError:
            store.put_file(keys.upload(accepted.upload_sha256), upload)
        with store.locked(keys.accepted(accepted.id)):
            if is_accepted(store, accepted.id):
                return _mend(store, accepted)
            store.delete_prefix(keys.folder(accepted.id))  # what a deletion that was interrupted left
            unfinished.mark(store, accepted.id, accepted.upload_sha256)
            store.put_bytes(keys.use(accepted.upload_sha256, accepted.id), b"")
            return store.put_bytes(keys.accepted(accepted.id), _json(accepted), create_only=True)


def is_accepted(store: Store, mesh_id: str) -> bool:
    """Whether the mesh is accepted and not deleted."""
    return store.exists(keys.accepted(mesh_id))


def read_accepted(store: Store, mesh_id: str) -> Accepted:
    """The acceptance record. Raises NotFoundError, DamagedUploadError."""
    try:
        return _read(store, keys.accepted(mesh_id), Accepted)
    except CorruptArtifactError as error:
        raise DamagedUploadError(DAMAGED_RECORD, mesh=mesh_id) from error


def upload_path(store: Store, sha256: str) -> Path:
    """The file of an upload, all of it compared with its hash. Raises DamagedUploadError, also when there is none."""
    try:
        return store.compared_path(keys.upload(sha256), sha256)
    except (NotFoundError, CorruptArtifactError) as error:
        raise DamagedUploadError(DAMAGED_BYTES) from error


def outlines(store: Store) -> Iterator[tuple[str, dict[str, str]]]:
    """All ids, those of meshes being deleted among them, with the versions of their acceptance, manifest and later stages' records.

    By the names of `schemas.keys`; what there is not of a mesh is missing.
    """
    return store.versions(keys.MESHES, OUTLINE)


@contextmanager
def publishing(store: Store, mesh_id: str) -> Iterator[None]:
    """Hold the mesh while writing below it. Raises CancelledError when it has been deleted."""
    with store.locked(keys.accepted(mesh_id)):
        if not is_accepted(store, mesh_id):
            raise CancelledError("the mesh has been deleted", mesh=mesh_id)
        yield


def write_stage(store: Store, mesh_id: str, record: StageRecord) -> None:
    """Write a stage's record, which ends what it had done in part; the caller holds `publishing`."""
    store.put_bytes(keys.stage_record(mesh_id, record.stage), _json(record))
    store.delete(keys.partial(mesh_id, record.stage))


def read_stage(store: Store, mesh_id: str, stage: str) -> StageRecord | None:
    """A stage's record, or None when it has not ended. A damaged one counts as none: the stage runs again."""
    try:
        return _read(store, keys.stage_record(mesh_id, stage), StageRecord)
    except NotFoundError:
        return None
    except CorruptArtifactError:
        log.exception("unreadable stage record", extra={"mesh": mesh_id, "stage": stage})
        return None


def write_manifest(store: Store, manifest: Manifest) -> bool:
    """Write the manifest, once: False when there was one. The caller holds `publishing`."""
    return store.put_bytes(keys.manifest(manifest.id), _json(manifest), create_only=True)


def read_manifest(store: Store, mesh_id: str) -> Manifest | None:
    """The manifest, or None while the mesh is in work. Raises DamagedArtifactError."""
    try:
        return _read(store, keys.manifest(mesh_id), Manifest)
    except NotFoundError:
        return None
    except CorruptArtifactError as error:
        raise DamagedArtifactError("a manifest is damaged", mesh=mesh_id) from error


def drop_damaged_manifest(store: Store, mesh_id: str) -> None:
    """Delete a manifest that cannot be read, to be made again; the caller holds `publishing`."""
    try:
        read_manifest(store, mesh_id)
    except DamagedArtifactError:
        log.exception("unreadable manifest", extra={"mesh": mesh_id})
        unfinished.mark(store, mesh_id)
        store.delete(keys.manifest(mesh_id))


def settle(store: Store, mesh_id: str, later: Collection[str]) -> None:
    """Take the mark from a mesh that has ended; unless it failed, so must have the stages `later`. Raises DamagedArtifactError."""
    if not unfinished.is_marked(store, mesh_id):
        return
    with store.locked(keys.accepted(mesh_id)):
        manifest = read_manifest(store, mesh_id)
        if manifest is not None and (manifest.status == "failed" or all(store.exists(keys.stage_record(mesh_id, s)) for s in later)):
            unfinished.unmark(store, mesh_id)


def forget(store: Store, mesh_id: str) -> bool:
    """Delete a mesh, its acceptance first, and its upload when no other mesh has it. False when there was no such mesh.

    Which upload it was a damaged acceptance does not say: that is swept some day.
    """
    try:
        upload = read_accepted(store, mesh_id).upload_sha256
    except NotFoundError:
        return False
    except DamagedUploadError:
        upload = None
    with _held(store, mesh_id, upload):
        return _remove(store, mesh_id, upload)


def remove_abandoned(store: Store, mesh_id: str) -> None:
    """Remove what is left of a mesh with a mark and no acceptance: its deletion, or its acceptance, was interrupted."""
    upload = unfinished.marked_upload(store, mesh_id)
    with _held(store, mesh_id, upload):
        if not is_accepted(store, mesh_id):
            _remove(store, mesh_id, upload)


@contextmanager
def _held(store: Store, mesh_id: str, upload: str | None) -> Iterator[None]:
    """Hold a mesh and, if it is known, its upload."""
    with nullcontext() if upload is None else store.locked(keys.upload(upload)), store.locked(keys.accepted(mesh_id)):
        yield


def _remove(store: Store, mesh_id: str, upload: str | None) -> bool:
    """Remove a mesh and the upload, if no other has it; whether there was the mesh. The caller holds both."""
    with suppress(StorageFullError):  # deleting is what makes room: without a mark `audit` does the rest if this is interrupted
        unfinished.mark(store, mesh_id, upload)
    existed = store.delete(keys.accepted(mesh_id))
    store.delete_prefix(keys.folder(mesh_id))
    store.delete(keys.use(upload or keys.UNKNOWN_UPLOAD, mesh_id))
    if upload is not None and not is_used(store, upload):
        store.delete(keys.upload(upload))
    unfinished.unmark(store, mesh_id)
    return existed


def _mend(store: Store, accepted: Accepted) -> bool:
    """Replace the acceptance of a mesh where it cannot be read, and forget failures that came of a damaged upload; whether there were any.

    The caller holds the mesh.
    """
    try:
        read_accepted(store, accepted.id)
        is_mended = False
    except DamagedUploadError:
        unfinished.mark(store, accepted.id, accepted.upload_sha256)
        store.put_bytes(keys.use(accepted.upload_sha256, accepted.id), b"")
        is_mended = store.put_bytes(keys.accepted(accepted.id), _json(accepted))
        store.delete(keys.use(keys.UNKNOWN_UPLOAD, accepted.id))
    ended = (read_stage(store, accepted.id, stage) for stage in STAGES)
    if failed := [record.stage for record in ended if record is not None and _is_of_damaged_upload(record)]:
        unfinished.mark(store, accepted.id, accepted.upload_sha256)
        store.delete(keys.manifest(accepted.id))
        for stage in failed:
            store.delete(keys.stage_record(accepted.id, stage))
    return is_mended or bool(failed)


def _is_of_damaged_upload(record: StageRecord) -> bool:
    return record.error is not None and (record.error.model_extra or {}).get("code") == DamagedUploadError.code


def is_used(store: Store, upload: str) -> bool:
    """Whether an accepted mesh has this upload, or may have: one whose record cannot be read. The caller holds the upload."""
    if store.exists(keys.USES_COMPLETE):
        users = chain(store.children(keys.uses(upload)), store.children(keys.uses(keys.UNKNOWN_UPLOAD)))
        return any(is_accepted(store, mesh_id) for mesh_id in users)
    return any(_may_have(store, mesh_id, upload) for mesh_id in store.children(keys.MESHES))


def _may_have(store: Store, mesh_id: str, upload: str) -> bool:
    try:
        return read_accepted(store, mesh_id).upload_sha256 == upload
    except NotFoundError:
        return False
    except DamagedUploadError:
        return True


def _json(record: BaseModel) -> bytes:
    return record.model_dump_json().encode()


def _read(store: Store, key: str, model: type[R]) -> R:
    try:
        return model.model_validate_json(store.get_bytes(key))
    except ValidationError as error:
        raise CorruptArtifactError("a record is damaged", key=key) from error
