"""The object store on local disk.

An object is a file under the root, its key the path. It is written to `.tmp/` on the same file system, synced, then renamed (or
linked, where it must not exist yet), and the folder is synced: a crash at any moment leaves the old object or the new one. Keys
cannot reach `.tmp/` or `.locks/`, since no part of a key starts with a dot.
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from contextlib import AbstractContextManager, suppress
from pathlib import Path
from typing import BinaryIO

from backend.store import Entry, Store, checked
from backend.temporary_files import FileLocks, TemporaryFiles, room
from schemas.errors import NotFoundError

PUBLISH_TRIES = 8  # a folder may be removed between its making and the rename into it


class LocalStore(Store):
    """Objects under a folder."""

    def __init__(self, root: Path) -> None:
        self.root = root.absolute()
        self._temporary = TemporaryFiles(self.root / ".tmp")
        self._locks = FileLocks(self.root / ".locks")

    def put_bytes(self, key: str, data: bytes, *, create_only: bool = False) -> bool:
        """As `Store.put_bytes`."""
        target = self._path(key)
        with self.temporary() as file:
            file.write(data)
            _sync(file)
            return self._publish(Path(file.name), target, create_only)

    def put_file(self, key: str, source: Path) -> None:
        """As `Store.put_file`: moved when it is on the store's file system, else copied."""
        target = self._path(key)
        if source.stat().st_dev == self._temporary.folder.stat().st_dev:
            with room(), source.open("rb") as file:
                os.fsync(file.fileno())
            self._publish(source, target, create_only=False)
            return
        with source.open("rb") as original, self.temporary() as file:
            shutil.copyfileobj(original, file, 1 << 20)
            _sync(file)
            self._publish(Path(file.name), target, create_only=False)

    def get_bytes(self, key: str) -> bytes:
        """As `Store.get_bytes`."""
        try:
            return self._path(key).read_bytes()
        except (FileNotFoundError, IsADirectoryError, NotADirectoryError):
            raise NotFoundError("there is no such object", key=key) from None

    def local_path(self, key: str) -> Path:
        """As `Store.local_path`."""
        path = self._path(key)
        if not path.is_file():
            raise NotFoundError("there is no such object", key=key)
        return path

    def drop_copy(self, key: str) -> bool:
        """As `Store.drop_copy`: files here are the objects."""
        return False

    def exists(self, key: str) -> bool:
        """As `Store.exists`."""
        return self._path(key).is_file()

    def version(self, key: str) -> str | None:
        """As `Store.version`; another one after any putting, of the same bytes too."""
        try:
            found = self._path(key).stat()
        except (FileNotFoundError, NotADirectoryError):
            return None
        return _version(found)

    def entries(self, prefix: str = "") -> Iterator[Entry]:
        """As `Store.entries`."""
        folder = prefix.rpartition("/")[0]
        start = self._path(folder) if folder else self.root
        for key in self._walk(start, f"{folder}/" if folder else ""):
            if key.startswith(prefix):
                with suppress(FileNotFoundError, NotADirectoryError):
                    found = (self.root / key).stat()
                    yield Entry(key, _version(found), found.st_mtime)

    def children(self, prefix: str) -> Iterator[str]:
        """As `Store.children`."""
        try:
            names = sorted(entry.name for entry in os.scandir(self._path(prefix.rstrip("/"))))
        except (FileNotFoundError, NotADirectoryError):
            return
        yield from (name for name in names if not name.startswith("."))

    def delete(self, key: str) -> bool:
        """As `Store.delete`."""
        path = self._path(key)
        try:
            path.unlink()
        except (FileNotFoundError, IsADirectoryError, NotADirectoryError):
            return False
        _sync_folder(path.parent)
        self._prune(path.parent)
        return True

    def temporary(self) -> AbstractContextManager[BinaryIO]:
        """As `Store.temporary`, on the store's file system."""
        return self._temporary.new()

    def locked(self, key: str) -> AbstractContextManager[None]:
        """As `Store.locked`; the processes are those of one machine, or of machines that share a file system with locks."""
        return self._locks.held(key)

    def free_bytes(self) -> int:
        """As `Store.free_bytes`: what the disk has left."""
        return self._temporary.free_bytes()

    def sweep_temporary(self, older_than_s: float) -> int:
        """As `Store.sweep_temporary`."""
        return self._temporary.sweep(older_than_s)

    def under(self, folder: str) -> LocalStore:
        """As `Store.under`."""
        return LocalStore(self.root / checked(folder))

    def check(self) -> None:
        """As `Store.check`: a temporary file."""
        with self.temporary() as file:
            file.write(b"ready")

    def _path(self, key: str) -> Path:
        return self.root / checked(key)

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
                with room():
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


def _version(found: os.stat_result) -> str:
    return f"{found.st_ino}-{found.st_mtime_ns}"


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
