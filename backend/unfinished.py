"""Meshes that something is still to be done for, each with a small object in the store: its mark, `unfinished/<mesh id>`.

So nobody goes through all meshes to find those in work: `JobQueue.reconcile` lists the marks. A mark may be there for nothing, which
costs a look; what must not be is an unfinished mesh without one. So a mark is put before what it stands for, and removed after it is
done, both by who holds the mesh. A process that dies between two writes leaves:

accept   upload | mark | use | acceptance        an upload that `audit` removes | a mark without an acceptance, twice: `remove_abandoned`
                                                 removes all three | a mesh in work, that `reconcile` enqueues
work     ... last record | manifest | no mark    a mesh in work; of one that has ended `reconcile` removes the mark
damage   mark | no manifest | no stage records   a mesh in work again, from the second of these on
forget   mark | no acceptance | no files |       an accepted mesh, whose mark `reconcile` removes if it has ended | a mark without an
         no use | no upload | no mark            acceptance: `remove_abandoned` does the rest

`audit` puts marks that are missing: those of meshes that an earlier version accepted, and those that were lost. Lost is one, too, when a
process is stopped on another machine until its lock is somebody else's, and then writes one thing more (`backend.records`).
"""

from __future__ import annotations

import time
from collections.abc import Iterator

from backend.store import Store
from schemas import keys
from schemas.errors import NotFoundError

ABANDONED_S = 600.0
"""A mark that is older has been put by nobody who is still about to accept its mesh."""


def mark(store: Store, mesh_id: str, upload: str | None = None) -> None:
    """Mark a mesh, anew where its upload (a sha256) is given; the caller holds the mesh. Raises StorageFullError."""
    if upload is not None or not is_marked(store, mesh_id):
        store.put_bytes(keys.unfinished(mesh_id), (upload or "").encode())


def unmark(store: Store, mesh_id: str) -> None:
    """Take the mark away; the caller holds the mesh."""
    store.delete(keys.unfinished(mesh_id))


def is_marked(store: Store, mesh_id: str) -> bool:
    """Whether the mesh has a mark."""
    return store.exists(keys.unfinished(mesh_id))


def marked(store: Store) -> Iterator[tuple[str, float]]:
    """The ids of all meshes with a mark, and how old it is, seconds, by the store's clock and this machine's."""
    for entry in store.entries(keys.UNFINISHED):
        mesh_id = entry.key.removeprefix(keys.UNFINISHED)
        if keys.MESH_ID.match(mesh_id):
            yield mesh_id, time.time() - entry.written


def marked_upload(store: Store, mesh_id: str) -> str | None:
    """The sha256 of the upload of a marked mesh, or None where the mark does not say."""
    try:
        told = store.get_bytes(keys.unfinished(mesh_id)).decode("ascii", "replace")
    except NotFoundError:
        return None
    return told if keys.SHA256.match(told) else None
