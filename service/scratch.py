"""Memory that is used again: fresh pages cost more than the work done in them."""

from __future__ import annotations

import threading

import numpy as np

from schemas.conventions import Array

KEPT_BYTES = 1 << 24
"""Buffers up to this size are kept."""


class Scratch:
    """Buffers by name, for one thread."""

    def __init__(self) -> None:
        self._buffers: dict[str, Array] = {}

    def array(self, name: str, shape: tuple[int, ...], dtype: type[np.generic]) -> Array:
        """Uninitialised memory of this shape, the same again when it was large enough."""
        size = np.dtype(dtype).itemsize
        for side in shape:
            size *= side
        buffer = self._buffers.get(name)
        if buffer is None or len(buffer) < size:
            buffer = np.empty(size + size // 4, np.uint8)
            if size <= KEPT_BYTES:
                self._buffers[name] = buffer
        return buffer[:size].view(dtype).reshape(shape)


class ThreadScratch(threading.local, Scratch):
    """The same, each thread with buffers of its own."""
