"""A small file system, to be filled for real."""

from __future__ import annotations

import ctypes
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

MNT_DETACH = 2


@contextmanager
def mounted(folder: Path, mib: int) -> Iterator[Path]:
    """A file system in memory of so many MiB at a new folder; the test is skipped where that may not be mounted."""
    libc = ctypes.CDLL(None, use_errno=True)
    folder.mkdir()
    if libc.mount(b"tmpfs", bytes(folder), b"tmpfs", 0, f"size={mib}m".encode()) != 0:
        pytest.skip("may not mount a small file system here")
    try:
        yield folder
    finally:
        libc.umount2(bytes(folder), MNT_DETACH)
