"""Meshes that are read for one answer and not kept: a store of their own beside the other, with no acceptance and no manifest.

The service puts the upload there under a token and a job into the queue; a reader leaves the mesh as the stage load leaves it, or what
is wrong with it; the service draws that and deletes everything under the token. What a service that died left is swept by its age.
"""

from __future__ import annotations

import secrets
import time
from pathlib import Path

from backend import records
from backend.store import Store
from schemas import keys
from schemas.manifest import StageRecord

FOLDER = "once"
LOAD = "load"


def store_of(store: Store) -> Store:
    """The store of the meshes that are not kept."""
    return store.under(FOLDER)


def put(store: Store, upload: Path) -> str:
    """Move an upload into `store_of` a store; its token. Raises StorageFullError."""
    token = secrets.token_hex(16)
    store.put_file(keys.upload(token), upload)
    return token


def is_wanted(store: Store, token: str) -> bool:
    """Whether somebody still waits for it."""
    return store.exists(keys.upload(token))


def answer(store: Store, token: str) -> StageRecord | None:
    """What the reader has made of it; None until then."""
    return records.read_stage(store, token, LOAD)


def forget(store: Store, token: str) -> None:
    """Delete everything of it."""
    store.delete(keys.upload(token))
    store.delete_prefix(keys.folder(token))


def sweep(store: Store, age_s: float) -> None:
    """Delete what has been there for longer than any request takes, temporary files too."""
    store.sweep_temporary(age_s)
    newest: dict[str, float] = {}
    for entry in store.entries():
        token = entry.key.split("/")[1]
        newest[token] = max(entry.written, newest.get(token, entry.written))
    for token, written in newest.items():
        if time.time() - written > age_s:
            forget(store, token)
