"""Keys in the object store, one small JSON each, and a short memory of them for the requests."""

from __future__ import annotations

import logging
import time
from collections import OrderedDict
from collections.abc import Iterator

from anyio import to_thread
from pydantic import ValidationError

from backend.store import Store
from schemas import keys
from schemas.access import KeyRecord, MadeKey, NewKey
from schemas.errors import CorruptArtifactError, NotFoundError
from service.access.tokens import KEY_ID, make_key

log = logging.getLogger("silhouette.access")

REMEMBERED_S = 3.0
"""Seconds after which a key that was revoked elsewhere is good here no longer, at most."""

REMEMBERED = 1024
NO_SUCH_KEY = "There is no such key; it may have been revoked."


class KeyStore:
    """The keys that there are. Every call does I/O and blocks; safe for any number of threads and processes."""

    def __init__(self, store: Store) -> None:
        self._store = store

    def add(self, wanted: NewKey) -> MadeKey:
        """Make a key; its token is in the answer and nowhere else. Raises StorageFullError."""
        record, made = make_key(wanted)
        self._store.put_bytes(keys.api_key(record.id), record.model_dump_json().encode(), create_only=True)
        return made

    def get(self, key_id: str) -> KeyRecord:
        """A key's record. Raises NotFoundError, CorruptArtifactError."""
        if not KEY_ID.fullmatch(key_id):
            raise NotFoundError(NO_SUCH_KEY)
        try:
            return KeyRecord.model_validate_json(self._store.get_bytes(keys.api_key(key_id)))
        except NotFoundError:
            raise NotFoundError(NO_SUCH_KEY) from None
        except ValidationError:  # not chained: pydantic quotes what it read
            raise CorruptArtifactError("the record of a key is damaged") from None

    def all(self) -> Iterator[KeyRecord]:
        """All keys, by id; those that cannot be read are in the log."""
        for name in list(self._store.children(keys.API_KEYS)):
            try:
                yield self.get(name.removesuffix(".json"))
            except NotFoundError:  # revoked meanwhile
                continue
            except CorruptArtifactError:
                log.exception("unreadable key", extra={"object": name})

    def any(self) -> bool:
        """Whether there is a key, expired and damaged ones included."""
        return next(iter(self._store.children(keys.API_KEYS)), None) is not None

    def revoke(self, key_id: str) -> None:
        """Remove a key for good. Raises NotFoundError."""
        if not KEY_ID.fullmatch(key_id) or not self._store.delete(keys.api_key(key_id)):
            raise NotFoundError(NO_SUCH_KEY)


class KeyRing:
    """What requests ask of the keys, remembered for `REMEMBERED_S`. For one event loop."""

    def __init__(self, stored: KeyStore, remembered_s: float = REMEMBERED_S) -> None:
        self.stored = stored
        self._remembered_s = remembered_s
        self._found: OrderedDict[str, tuple[float, KeyRecord | None]] = OrderedDict()
        self._any: tuple[float, bool] = (0.0, False)

    async def find(self, key_id: str) -> KeyRecord | None:
        """A key's record; None when there is none. Raises CorruptArtifactError."""
        if not KEY_ID.fullmatch(key_id):
            return None
        until, record = self._found.get(key_id, (0.0, None))
        if time.monotonic() < until:
            return record
        record = await to_thread.run_sync(self._read, key_id)
        self._found[key_id] = time.monotonic() + self._remembered_s, record
        self._found.move_to_end(key_id)
        while len(self._found) > REMEMBERED:
            self._found.popitem(last=False)
        return record

    async def any(self) -> bool:
        """Whether there is a key."""
        until, found = self._any
        if time.monotonic() >= until:
            found = await to_thread.run_sync(self.stored.any)
            self._any = time.monotonic() + self._remembered_s, found
        return found

    def forget(self) -> None:
        """Remember nothing: a key has been made or revoked here."""
        self._found.clear()
        self._any = (0.0, False)

    def _read(self, key_id: str) -> KeyRecord | None:
        try:
            return self.stored.get(key_id)
        except NotFoundError:
            return None
