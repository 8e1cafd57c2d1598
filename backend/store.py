"""The object store: named bytes, durable once a call returns, all or nothing.

Local disk. An object is a file under the root, its key the path. It is written to `.tmp/` on the same file system, synced,
then renamed (or linked, where it must not exist yet), and the folder is synced: a crash at any moment leaves the old object
or the new one. Keys cannot reach `.tmp/` or `.locks/`, since no part of a key starts with a dot.
"""

from __future__ import annotations

import errno
import fcntl
import os
import re
import shutil
import tempfile
import time
import zlib
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO, cast

from schemas.errors import NotFoundError, StorageFullError

KEY = re.compile(r"[A-Za-z0-9_-][A-Za-z0-9._-]*(/[A-Za-z0-9_-][A-Za-z0-9._-]*)*")
LOCK_FILES = 64  # per kind of key; two keys that share one wait for each other, no more
NO_ROOM = frozenset({errno.ENOSPC, errno.EDQUOT, errno.EFBIG})
PUBLISH_TRIES = 8  # a folder may be removed between its making and the rename into it


class Store:
    """Objects under a folder. Safe for any number of threads and processes at once.

    Raises StorageFullError from every writing call when there is no room, and ValueError for a key that is not one.
    """

    def __init__(self, root: Path) -> None:
        self.root = root.absolute()
        self._temporary = self.root / ".tmp"
        self._locks = self.root / ".locks"
        for folder in (self._temporary, self._locks):
            folder.mkdir(parents=True, exist_ok=True)

    def put_bytes(self, key: str, data: bytes, *, create_only: bool = False) -> bool:
        """Store `data`. With `create_only` an existing object stays as it is, and the answer is False."""
        target = self._path(key)
        with self.temporary() as file:
            file.write(data)
            _sync(file)
            return self._publish(Path(file.name), target, create_only)

    def put_file(self, key: str, source: Path) -> None:
        """Store the file `source`: moved when it is on the store's file system, else copied."""
        target = self._path(key)
        if source.stat().st_dev == self._temporary.stat().st_dev:
            with _room(), source.open("rb") as file:
                os.fsync(file.fileno())
            self._publish(source, target, create_only=False)
            return
        with source.open("rb") as original, self.temporary() as file:
            shutil.copyfileobj(original, file, 1 << 20)
            _sync(file)
            self._publish(Path(file.name), target, create_only=False)

    def get_bytes(self, key: str) -> bytes:
        """The object's bytes. Raises NotFoundError."""
        try:
            return self._path(key).read_bytes()
        except (FileNotFoundError, IsADirectoryError, NotADirectoryError):
            raise NotFoundError("there is no such object", key=key) from None

    def local_path(self, key: str) -> Path:
        """A file of this machine with the object's bytes, for mapping; to be read only. Raises NotFoundError."""
        path = self._path(key)
        if not path.is_file():
            raise NotFoundError("there is no such object", key=key)
        return path

    def exists(self, key: str) -> bool:
        """Whether there is such an object."""
        return self._path(key).is_file()

    def version(self, key: str) -> str | None:
        """A text that is another one after each `put_...` of the key; None when there is no such object."""
        try:
            found = self._path(key).stat()
        except (FileNotFoundError, NotADirectoryError):
            return None
        return f"{found.st_ino}-{found.st_mtime_ns}"

    def list(self, prefix: str = "") -> Iterator[str]:
        """Keys that start with `prefix`, sorted within each folder."""
        folder = prefix.rpartition("/")[0]
        start = self._path(folder) if folder else self.root
        for key in self._walk(start, f"{folder}/" if folder else ""):
            if key.startswith(prefix):
                yield key

    def children(self, prefix: str) -> Iterator[str]:
        """Names directly under `prefix` (which ends with "/"), sorted: `children("meshes/")` are mesh ids."""
        try:
            names = sorted(entry.name for entry in os.scandir(self._path(prefix.rstrip("/"))))
        except (FileNotFoundError, NotADirectoryError):
            return
        yield from (name for name in names if not name.startswith("."))

    def delete(self, key: str) -> bool:
        """Remove one object; False when there was none."""
        path = self._path(key)
        try:
            path.unlink()
        except (FileNotFoundError, IsADirectoryError, NotADirectoryError):
            return False
        _sync_folder(path.parent)
        self._prune(path.parent)
        return True

    def delete_prefix(self, prefix: str) -> int:
        """Remove every object under `prefix` (which ends with "/"); how many there were."""
        if not prefix.endswith("/"):
            raise ValueError(f"a prefix to delete ends with a slash: {prefix!r}")
        return sum(self.delete(key) for key in list(self.list(prefix)))

    @contextmanager
    def temporary(self) -> Iterator[BinaryIO]:
        """A new file on the store's file system, open for writing; gone at the end unless `put_file` has moved it away.

        "No room" inside the block comes out as StorageFullError. `file.name` is its path.
        """
        file: BinaryIO | None = None
        try:
            with _room(), tempfile.NamedTemporaryFile(dir=self._temporary, delete=False) as opened:
                file = cast(BinaryIO, opened)
                yield file
        finally:
            if file is not None:
                Path(file.name).unlink(missing_ok=True)

    @contextmanager
    def locked(self, key: str) -> Iterator[None]:
        """One holder at a time, over all threads and processes. Locks of the same first key part must not be nested."""
        name = f"{key.partition('/')[0]}-{zlib.crc32(key.encode()) % LOCK_FILES:02d}"
        with _room(), (self._locks / name).open("ab") as file:
            fcntl.flock(file, fcntl.LOCK_EX)  # released by closing, also when the process is killed
            yield

    def free_bytes(self) -> int:
        """Bytes that can still be written."""
        return shutil.disk_usage(self.root).free

    def sweep_temporary(self, older_than_s: float) -> int:
        """Remove temporary files that nobody has written to for so long; how many."""
        count = 0
        for entry in os.scandir(self._temporary):
            with suppress(FileNotFoundError):
                if time.time() - entry.stat().st_mtime > older_than_s:
                    Path(entry.path).unlink()
                    count += 1
        return count

    def _path(self, key: str) -> Path:
        if not KEY.fullmatch(key):
            raise ValueError(f"not a key: {key!r}")
        return self.root / key

    def _walk(self, folder: Path, prefix: str) -> Iterator[str]:
        try:
            entries = sorted(os.scandir(folder), key=lambda entry: entry.name)
        except (FileNotFoundError, NotADirectoryError):
            return
        for entry in entries:
            if entry.name.startswith("."):
                continue
            if entry.is_dir():
                yield from self._walk(Path(entry.path), f"{prefix}{entry.name}/")
            else:
                yield prefix + entry.name

    def _publish(self, source: Path, target: Path, create_only: bool) -> bool:
        for remaining in reversed(range(PUBLISH_TRIES)):
            try:
                with _room():
                    self._make_folder(target.parent)
                    if create_only:
                        os.link(source, target)
                    else:
                        source.replace(target)
                    _sync_folder(target.parent)
            except FileExistsError:
                return False
            except FileNotFoundError:
                if not remaining or not source.exists():
                    raise
            else:
                return True
        raise AssertionError("unreachable")

    def _make_folder(self, folder: Path) -> None:
        if folder == self.root or folder.is_dir():
            return
        self._make_folder(folder.parent)
        # not mkdir(exist_ok=True): that raises FileExistsError when the folder was there and is pruned a moment later
        with suppress(FileExistsError):
            folder.mkdir()
        _sync_folder(folder.parent)

    def _prune(self, folder: Path) -> None:
        while folder != self.root:
            try:
                folder.rmdir()
            except OSError:  # not empty, or another process was first
                return
            folder = folder.parent


def _sync(file: BinaryIO) -> None:
    file.flush()
    os.fsync(file.fileno())


def _sync_folder(folder: Path) -> None:
    try:
        descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    except FileNotFoundError:  # pruned by another process: then nothing in it is left to be kept
        return
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


@contextmanager
def _room() -> Iterator[None]:
    try:
        yield
    except OSError as error:
        if error.errno in NO_ROOM:
            raise StorageFullError("the store has no room left") from error
        raise
