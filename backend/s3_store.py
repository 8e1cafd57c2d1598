"""The object store in an S3 bucket, for many machines.

Needs of the server what Amazon's has: reading what was just written, and conditional puts (`If-None-Match`, `If-Match`). Objects that
are opened as files are copied to this machine's disk first (`backend.object_cache`). Locks are `backend.leases`: a holder that may
have lost its lock writes nothing any more.
"""

from __future__ import annotations

import hashlib
import secrets
from collections.abc import Collection, Iterator
from contextlib import AbstractContextManager, contextmanager, suppress
from itertools import groupby
from pathlib import Path
from typing import BinaryIO

from backend.leases import Leases
from backend.object_cache import ObjectCache
from backend.s3_client import DELETE_AT_ONCE, ChangedError, Meta, S3Client, S3Place
from backend.store import Entry, Store, checked
from backend.temporary_files import FileLocks, TemporaryFiles, lock_name
from schemas.errors import NotFoundError

LOCKS = ".locks/"
LOCK_OBJECTS = 256  # per kind of key; a multiple of LOCK_FILES, so that keys that share one of these share one of those
CHECK_KEY = ".check"
DOWNLOAD_TRIES = 3  # an object may be replaced between the look at it and its download


class S3Store(Store):
    """Objects at a place. `folder` on this machine's disk holds copies, of `cache_bytes` at most, and files in the making."""

    look_interval_s = 1.0

    def __init__(self, place: S3Place, folder: Path, cache_bytes: int) -> None:
        self._place, self._folder, self._cache_bytes = place, folder, cache_bytes
        self._client = S3Client(place)
        self._cache = ObjectCache(folder, cache_bytes)
        self._leases = Leases(self._client, LOCKS, _home(folder, self._cache.scratch))
        self._neighbours = FileLocks(folder / "locks")

    def put_bytes(self, key: str, data: bytes, *, create_only: bool = False) -> bool:
        """As `Store.put_bytes`."""
        checked(key)
        self._leases.check()
        if not create_only:
            self._client.put(key, data)
            return True
        try:
            self._client.replace(key, data, None)
        except ChangedError:
            return False
        return True

    def put_file(self, key: str, source: Path) -> None:
        """As `Store.put_file`; what was sent is kept as this machine's copy."""
        checked(key)
        with source.open("rb") as file:
            sha256 = hashlib.file_digest(file, "sha256").hexdigest()
        self._leases.check()
        tag = self._client.put_file(key, source, sha256)
        self._leases.check()
        self._cache.adopt(self._named(key), tag, source)

    def get_bytes(self, key: str) -> bytes:
        """As `Store.get_bytes`."""
        return self._client.get(checked(key))[0]

    def local_path(self, key: str) -> Path:
        """As `Store.local_path`: this machine's copy of the present version."""
        for _ in range(DOWNLOAD_TRIES):
            found = self._head(key)
            if found is None:
                break
            tag = found.tag
            try:
                return self._cache.path_of(self._named(key), tag, found.size, lambda tag=tag: self._client.download(key, tag))  # type: ignore[misc]
            except ChangedError:
                continue
        raise NotFoundError("there is no such object", key=key)

    def drop_copy(self, key: str) -> bool:
        """As `Store.drop_copy`, of the present version."""
        found = self._head(key)
        return found is not None and self._cache.drop(self._named(key), found.tag)

    def exists(self, key: str) -> bool:
        """As `Store.exists`."""
        return self._head(key) is not None

    def version(self, key: str) -> str | None:
        """As `Store.version`: the entity tag."""
        found = self._head(key)
        return None if found is None else found.tag

    def entries(self, prefix: str = "") -> Iterator[Entry]:
        """As `Store.entries`: a request for each thousand."""
        for found in self._client.list(prefix.rpartition("/")[0]):
            if found.key.startswith(prefix) and not found.key.startswith("."):
                yield Entry(found.key, found.tag, found.written)

    def children(self, prefix: str) -> Iterator[str]:
        """As `Store.children`."""
        folders, objects = self._client.folders(checked(prefix.rstrip("/")))
        names = {path.rpartition("/")[2] for path in folders | objects}
        yield from sorted(name for name in names if not name.startswith("."))

    def versions(self, prefix: str, names: Collection[str]) -> Iterator[tuple[str, dict[str, str]]]:
        """As `Store.versions`, from one listing of everything under the prefix."""
        behind = len(prefix)
        for child, entries in groupby(self.entries(prefix), lambda entry: entry.key[behind:].partition("/")[0]):
            found = ((entry.key[behind + len(child) + 1 :], entry.version) for entry in entries)
            yield child, {name: version for name, version in found if name in names}

    def delete(self, key: str) -> bool:
        """As `Store.delete`."""
        if not self.exists(key):
            return False
        self._leases.check()
        self._client.delete([key])
        return True

    def delete_prefix(self, prefix: str) -> int:
        """As `Store.delete_prefix`, many at a time."""
        if not prefix.endswith("/"):
            raise ValueError(f"a prefix to delete ends with a slash: {prefix!r}")
        keys = [*self.list(prefix)]
        for first in range(0, len(keys), DELETE_AT_ONCE):
            self._leases.check()
            self._client.delete(keys[first : first + DELETE_AT_ONCE])
        return len(keys)

    def temporary(self) -> AbstractContextManager[BinaryIO]:
        """As `Store.temporary`, beside the copies."""
        return self._cache.scratch.new()

    @contextmanager
    def locked(self, key: str) -> Iterator[None]:
        """As `Store.locked`. Processes of one machine wait for each other without asking the store."""
        with self._neighbours.held(key), self._leases.held(lock_name(key, LOCK_OBJECTS)):
            yield

    def free_bytes(self) -> int:
        """As `Store.free_bytes`: what the disk for files in the making has left; the store does not say what it has."""
        return self._cache.scratch.free_bytes()

    def sweep_temporary(self, older_than_s: float) -> int:
        """As `Store.sweep_temporary`; parts of objects that were never completed are for a rule of the bucket to remove."""
        return self._cache.scratch.sweep(older_than_s)

    def under(self, folder: str) -> S3Store:
        """As `Store.under`; copies are kept together."""
        return S3Store(self._place.under(checked(folder)), self._folder, self._cache_bytes)

    def check(self) -> None:
        """As `Store.check`: an object of a name that is no key."""
        self._client.put(CHECK_KEY, b"ready")
        with self.temporary() as file:
            file.write(b"ready")

    def _head(self, key: str) -> Meta | None:
        return self._client.head(checked(key))

    def _named(self, key: str) -> str:
        """Where an object is, over all stores: copies of several may lie in one folder."""
        return f"{self._place.endpoint or ''} {self._place.bucket}/{self._place.prefix}/{key}"


def _home(folder: Path, scratch: TemporaryFiles) -> str:
    """A name of the folder that no other has."""
    path = folder / "home"
    if not path.exists():
        with scratch.new() as file, suppress(FileExistsError):
            file.write(secrets.token_hex(16).encode())
            file.flush()
            path.hardlink_to(file.name)
    return path.read_text()
