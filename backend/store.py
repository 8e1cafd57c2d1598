"""The object store: named bytes, durable once a call returns, all or nothing.

Its two kinds are `backend.local_store` and `backend.s3_store`; `backend.stores` opens the one that the settings name.

A key is a path of plain names; no part of it starts with a dot, so a store may keep things of its own under such names.
"""

from __future__ import annotations

import hashlib
import re
from abc import ABC, abstractmethod
from collections.abc import Callable, Collection, Iterator
from contextlib import AbstractContextManager
from pathlib import Path
from typing import BinaryIO, NamedTuple, Self, TypeVar

from schemas.errors import CorruptArtifactError

T = TypeVar("T")
KEY = re.compile(r"[A-Za-z0-9_-][A-Za-z0-9._-]*(/[A-Za-z0-9_-][A-Za-z0-9._-]*)*")


class Entry(NamedTuple):
    """An object in a listing. version: as `Store.version`; written: seconds since 1970, by the store's clock."""

    key: str
    version: str
    written: float


class Store(ABC):
    """Objects by key. Safe for any number of threads and processes at once.

    Every call raises ValueError for a key that is not one, and StoreUnavailableError where the store is another machine that does not
    answer; every writing call StorageFullError when there is no room.
    """

    look_interval_s: float = 0.0
    """Between two looks at what seldom changes, such as whether a mesh is still wanted: 0 where a look costs microseconds."""

    @abstractmethod
    def put_bytes(self, key: str, data: bytes, *, create_only: bool = False) -> bool:
        """Store `data`. With `create_only` an existing object stays as it is, and the answer is False."""

    @abstractmethod
    def put_file(self, key: str, source: Path) -> None:
        """Store the file `source`, which may be moved away: it must not be written to any more."""

    @abstractmethod
    def get_bytes(self, key: str) -> bytes:
        """The object's bytes. Raises NotFoundError."""

    @abstractmethod
    def local_path(self, key: str) -> Path:
        """A file of this machine with the object's bytes, for mapping at once; to be read only. Raises NotFoundError."""

    @abstractmethod
    def drop_copy(self, key: str) -> bool:
        """Remove this machine's copy of the object; False where there is none, or where the object itself is on this machine."""

    @abstractmethod
    def exists(self, key: str) -> bool:
        """Whether there is such an object."""

    @abstractmethod
    def version(self, key: str) -> str | None:
        """A text that is another one after each putting of other bytes under the key; None when there is no such object."""

    @abstractmethod
    def entries(self, prefix: str = "") -> Iterator[Entry]:
        """Objects whose keys start with `prefix`, sorted within each folder."""

    @abstractmethod
    def children(self, prefix: str) -> Iterator[str]:
        """Names directly under `prefix` (which ends with "/"), sorted: `children("meshes/")` are mesh ids."""

    @abstractmethod
    def delete(self, key: str) -> bool:
        """Remove one object; False when there was none."""

    @abstractmethod
    def temporary(self) -> AbstractContextManager[BinaryIO]:
        """A new file of this machine, open for writing; gone at the end unless `put_file` has moved it away.

        "No room" inside the block comes out as StorageFullError. `file.name` is its path.
        """

    @abstractmethod
    def locked(self, key: str) -> AbstractContextManager[None]:
        """One holder at a time, over all threads, processes and machines. Locks of the same first key part must not be nested."""

    @abstractmethod
    def free_bytes(self) -> int:
        """Bytes that an upload may still take here."""

    @abstractmethod
    def sweep_temporary(self, older_than_s: float) -> int:
        """Remove temporary files that nobody has written to for so long; how many."""

    @abstractmethod
    def under(self, folder: str) -> Self:
        """A store of its own in a folder of this one, which must not be a first part of this one's keys."""

    @abstractmethod
    def check(self) -> None:
        """Write something, to see that it can be done. Raises StorageFullError, StoreUnavailableError, OSError."""

    def read_local(self, key: str, read: Callable[[Path], T]) -> T:
        """What `read` makes of the object's file. When that is damaged and only a copy, of another copy of the object.

        Raises NotFoundError, and CorruptArtifactError when `read` does so of what is not a copy, or of a new one.
        """
        try:
            return read(self.local_path(key))
        except CorruptArtifactError:
            if not self.drop_copy(key):
                raise
        return read(self.local_path(key))

    def compared_path(self, key: str, sha256: str | None) -> Path:
        """`local_path` of an object, all of it compared with this hash. Raises NotFoundError, CorruptArtifactError."""

        def compared(path: Path) -> Path:
            with path.open("rb") as file:
                if hashlib.file_digest(file, "sha256").hexdigest() != sha256:
                    raise CorruptArtifactError("an object's bytes have changed since it was stored")
            return path

        return self.read_local(key, compared)

    def list(self, prefix: str = "") -> Iterator[str]:
        """Keys that start with `prefix`, sorted within each folder."""
        return (entry.key for entry in self.entries(prefix))

    def versions(self, prefix: str, names: Collection[str]) -> Iterator[tuple[str, dict[str, str]]]:
        """Each child of `prefix`, with the versions of those of its objects `prefix/child/name` that there are."""
        for child in self.children(prefix):
            found = ((name, self.version(f"{prefix}{child}/{name}")) for name in names)
            yield child, {name: version for name, version in found if version is not None}

    def delete_prefix(self, prefix: str) -> int:
        """Remove every object under `prefix` (which ends with "/"); how many there were."""
        if not prefix.endswith("/"):
            raise ValueError(f"a prefix to delete ends with a slash: {prefix!r}")
        return sum(self.delete(entry.key) for entry in [*self.entries(prefix)])


def checked(key: str) -> str:
    """The key. Raises ValueError for what is none."""
    if not KEY.fullmatch(key):
        raise ValueError(f"not a key: {key!r}")
    return key
