"""Reading and writing the records that make the store the truth (`schemas.manifest`).

Two locks keep acceptance, publication and deletion apart, always taken in this order: the upload's, then the mesh's.
After `forget` nothing of a mesh can be written any more, unless it is accepted again.

On many machines a lock is a lease (`backend.leases`), and a process that was stopped at the wrong moment may write one thing after it
has lost it. What each such write can do:

accept   puts an upload under the hash of its bytes, and a record only where there is none: never anything wrong.
publish  puts artifacts whose bytes follow from the mesh's id, and a manifest only where there is none. Of a mesh that is accepted they
         are right, whoever writes them; of one that was deleted meanwhile nobody looks at them, `accept` clears them away before the
         mesh is accepted again, and `sweep` some day.
forget   deletes the acceptance first: done late, that is a deletion whose caller has not been answered yet. Done late, deleting what
         is behind it could take artifacts, or the upload, from a mesh that was accepted anew meanwhile; nothing is published of it that
         is not whole, but it may fail and have to be uploaded again. So every batch of deletions looks at the lease first.
"""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TypeVar

from pydantic import BaseModel, ValidationError

from backend.store import Store
from schemas import keys
from schemas.errors import CancelledError, CorruptArtifactError, NotFoundError
from schemas.jobs import LATER_STAGES
from schemas.manifest import Accepted, Manifest, StageRecord

log = logging.getLogger(__name__)
OUTLINE = frozenset({keys.ACCEPTED, keys.MANIFEST, *map(keys.stage_name, LATER_STAGES)})

_uploads: dict[str, str] = {}
"""Uploads of meshes by their ids, which say what they are made of: what was read once stays true."""

R = TypeVar("R", bound=BaseModel)


def accept(store: Store, accepted: Accepted, upload: Path) -> bool:
    """Make an upload durable: its bytes (the file `upload`, moved away), then its record. False when it was accepted before.

    Raises StorageFullError; then nothing is accepted.
    """
    with store.locked(keys.upload(accepted.upload_sha256)):
        if not store.exists(keys.upload(accepted.upload_sha256)):
            store.put_file(keys.upload(accepted.upload_sha256), upload)
        with store.locked(keys.accepted(accepted.id)):
            if is_accepted(store, accepted.id):
                return False
            store.delete_prefix(keys.folder(accepted.id))  # what a deletion that was interrupted left
            return store.put_bytes(keys.accepted(accepted.id), _json(accepted), create_only=True)


def is_accepted(store: Store, mesh_id: str) -> bool:
    """Whether the mesh is accepted and not deleted."""
    return store.exists(keys.accepted(mesh_id))


def read_accepted(store: Store, mesh_id: str) -> Accepted:
    """The acceptance record. Raises NotFoundError."""
    return _read(store, keys.accepted(mesh_id), Accepted)


def list_accepted(store: Store) -> Iterator[Accepted]:
    """All accepted meshes, by id."""
    for mesh_id in store.children(keys.MESHES):
        try:
            yield read_accepted(store, mesh_id)
        except NotFoundError:  # deleted meanwhile
            continue
        except CorruptArtifactError:
            log.exception("unreadable acceptance record", extra={"mesh": mesh_id})


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
    """The manifest, or None while the mesh is in work."""
    try:
        return _read(store, keys.manifest(mesh_id), Manifest)
    except NotFoundError:
        return None


def forget(store: Store, mesh_id: str) -> bool:
    """Delete a mesh, its acceptance first, and its upload when no other mesh has it. False when there was no such mesh."""
    try:
        upload = read_accepted(store, mesh_id).upload_sha256
    except NotFoundError:
        return False
    with store.locked(keys.upload(upload)):
        existed = _forget_mesh(store, mesh_id)
        if not _is_used(store, upload):
            store.delete(keys.upload(upload))
    return existed


def sweep(store: Store, temporary_age_s: float) -> None:
    """Remove what interrupted calls left: old temporary files, meshes and uploads without an acceptance record."""
    store.sweep_temporary(temporary_age_s)
    found = dict(outlines(store))
    for mesh_id in (mesh_id for mesh_id, names in found.items() if keys.ACCEPTED not in names):
        with store.locked(keys.accepted(mesh_id)):
            if not is_accepted(store, mesh_id):
                store.delete_prefix(keys.folder(mesh_id))
    in_use = {_upload_of(store, mesh_id) for mesh_id, names in found.items() if keys.ACCEPTED in names}
    for upload in set(store.children(keys.UPLOADS)) - in_use:
        with store.locked(keys.upload(upload)):
            if not _is_used(store, upload):
                store.delete(keys.upload(upload))


def _forget_mesh(store: Store, mesh_id: str) -> bool:
    with store.locked(keys.accepted(mesh_id)):
        existed = store.delete(keys.accepted(mesh_id))
        store.delete_prefix(keys.folder(mesh_id))
        return existed


def _is_used(store: Store, upload: str) -> bool:
    """Whether an accepted mesh has this upload."""
    return any(_upload_of(store, mesh_id) == upload and is_accepted(store, mesh_id) for mesh_id in store.children(keys.MESHES))


def _upload_of(store: Store, mesh_id: str) -> str | None:
    if mesh_id not in _uploads:
        try:
            _uploads[mesh_id] = read_accepted(store, mesh_id).upload_sha256
        except (NotFoundError, CorruptArtifactError):
            return None
    return _uploads[mesh_id]


def _json(record: BaseModel) -> bytes:
    return record.model_dump_json().encode()


def _read(store: Store, key: str, model: type[R]) -> R:
    try:
        return model.model_validate_json(store.get_bytes(key))
    except ValidationError as error:
        raise CorruptArtifactError("a record is damaged", key=key) from error
