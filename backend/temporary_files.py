"""Files in the making, and locks between the processes of one machine: a folder of each."""

from __future__ import annotations

import errno
import fcntl
import os
import shutil
import tempfile
import time
import zlib
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO, cast

from schemas.errors import StorageFullError

LOCK_FILES = 64  # per kind of key; two keys that share one wait for each other, no more
NO_ROOM = frozenset({errno.ENOSPC, errno.EDQUOT, errno.EFBIG})


class TemporaryFiles:
    """A folder of files that are gone when whoever makes them is done."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        folder.mkdir(parents=True, exist_ok=True)

    @contextmanager
    def new(self) -> Iterator[BinaryIO]:
        """A new file, open for writing; gone at the end unless it has been moved away. Raises StorageFullError."""
        file: BinaryIO | None = None
        try:
            with room(), tempfile.NamedTemporaryFile(dir=self.folder, delete=False) as opened:
                file = cast(BinaryIO, opened)
                yield file
        finally:
            if file is not None:
                Path(file.name).unlink(missing_ok=True)

    def free_bytes(self) -> int:
        """Bytes that can still be written."""
        return shutil.disk_usage(self.folder).free

    def sweep(self, older_than_s: float) -> int:
        """Remove files that nobody has written to for so long; how many."""
        count = 0
        for entry in os.scandir(self.folder):
            with suppress(FileNotFoundError):
                if time.time() - entry.stat().st_mtime > older_than_s:
                    Path(entry.path).unlink()
                    count += 1
        return count


class FileLocks:
    """Locks by key, over the threads and processes of this machine, as locked files in a folder."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        folder.mkdir(parents=True, exist_ok=True)

    @contextmanager
    def held(self, key: str) -> Iterator[None]:
        """One holder at a time. Locks of the same first key part must not be nested. Raises StorageFullError."""
        with room(), (self._folder / lock_name(key, LOCK_FILES)).open("ab") as file:
            fcntl.flock(file, fcntl.LOCK_EX)  # released by closing, also when the process is killed
            yield


def lock_name(key: str, count: int) -> str:
    """Name of the lock of a key: one of so many for each first key part."""
    return f"{key.partition('/')[0]}-{zlib.crc32(key.encode()) % count:02d}"


@contextmanager
def room() -> Iterator[None]:
    """Make StorageFullError of the system's ways to say that there is no room."""
    try:
        yield
    except OSError as error:
        if error.errno in NO_ROOM:
            raise StorageFullError("the store has no room left") from error
        raise
