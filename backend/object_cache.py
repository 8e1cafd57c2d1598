"""Copies of objects on this machine's disk, for mapping; the least recently used go when they are too many.

A copy's name is a hash of where the object is and of its version, so a copy never goes stale: another version has another name. It is
made under a temporary name, compared with the sha256 that the object was stored with, and renamed. A copy that this machine's disk has
damaged since is found by whoever reads it, and dropped.
"""

from __future__ import annotations

import hashlib
import logging
import os
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path

from backend.temporary_files import FileLocks, TemporaryFiles
from schemas.errors import CorruptArtifactError, StorageFullError

log = logging.getLogger(__name__)

SPARED_S = 120.0
"""A copy that was asked for within this time is not removed, for it may not be mapped yet. Once mapped, a removed file lives on."""

Download = Callable[[], tuple[str | None, Iterator[bytes]]]
"""(sha256 of an object, if it is known, and its bytes in pieces)."""


class ObjectCache:
    """Copies in a folder, of `limit_bytes` at most but for those just asked for. For any number of processes at once."""

    def __init__(self, folder: Path, limit_bytes: int) -> None:
        self._limit = limit_bytes
        self._copies = folder / "copies"
        self._copies.mkdir(parents=True, exist_ok=True)
        self._locks = FileLocks(folder / "locks")
        self.scratch = TemporaryFiles(folder / "scratch")

    def path_of(self, place: str, tag: str, size: int, download: Download) -> Path:
        """The copy of a version of an object, downloaded where there is none, once however many ask at the same time.

        Raises CorruptArtifactError when what came is not what was stored, StorageFullError, and what `download` raises.
        """
        copy = self._copies / _name(place, tag)
        if _touched(copy):
            return copy
        with self._locks.held(f"copies/{copy.name}"):
            if _touched(copy):
                return copy
            try:
                self._fetch(copy, size, download)
            except StorageFullError:
                if not self.evict(0):
                    raise
                self._fetch(copy, size, download)
        self.evict(self._limit)
        return copy

    def adopt(self, place: str, tag: str, source: Path) -> None:
        """Keep a file that was just stored as the copy of its object, when it is on the same file system."""
        with suppress(OSError):
            source.rename(self._copies / _name(place, tag))
            self.evict(self._limit)

    def drop(self, place: str, tag: str) -> bool:
        """Remove the copy of a version of an object, which has turned out to be damaged; False when there is none."""
        try:
            (self._copies / _name(place, tag)).unlink()
        except FileNotFoundError:
            return False
        log.error("a damaged copy was removed", extra={"object": place})
        return True

    def evict(self, limit_bytes: int) -> int:
        """Remove copies, least recently used first, until there are no more than this together; how many bytes went."""
        found, removed = [], 0
        for entry in os.scandir(self._copies):
            with suppress(FileNotFoundError):
                state = entry.stat()
                found.append((state.st_mtime, state.st_size, entry.path))
        surplus = sum(size for _, size, _ in found) - limit_bytes
        spared_from = time.time() - SPARED_S
        for used, size, path in sorted(found):
            if removed >= surplus or used > spared_from:
                break
            Path(path).unlink(missing_ok=True)
            removed += size
        return removed

    def _fetch(self, copy: Path, size: int, download: Download) -> None:
        sha256, pieces = download()
        digest, got = hashlib.sha256(), 0
        with self.scratch.new() as file:
            for piece in pieces:
                digest.update(piece)
                got += file.write(piece)
            file.flush()
            if got != size or sha256 not in (None, digest.hexdigest()):
                log.error("a downloaded object is damaged", extra={"bytes": got, "expected": size})
                raise CorruptArtifactError("an object is not what was stored")
            Path(file.name).rename(copy)


def _name(place: str, tag: str) -> str:
    return hashlib.sha256(f"{place}\n{tag}".encode()).hexdigest()


def _touched(copy: Path) -> bool:
    """Whether there is such a copy; it counts as just used."""
    try:
        os.utime(copy)
    except FileNotFoundError:
        return False
    return True
