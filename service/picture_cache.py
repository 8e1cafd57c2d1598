"""Encoded pictures that were asked for lately, by entity tag: a tag says mesh, request and program, so that what it names never changes."""

from __future__ import annotations

import asyncio
import threading
from collections import OrderedDict
from collections.abc import AsyncIterator, Mapping
from contextlib import asynccontextmanager
from dataclasses import dataclass

from schemas.errors import TOO_LATE, BusyError

HEADER_BYTES = 1024
"""About what a picture takes beside its body."""


@dataclass(frozen=True)
class KeptPicture:
    """An answer. headers: what it says of itself, times apart."""

    body: bytes
    headers: Mapping[str, str]

    @property
    def nbytes(self) -> int:
        """About what it takes in memory."""
        return len(self.body) + HEADER_BYTES


class PictureCache:
    """At most so many bytes of pictures, least recently used first to go. `alone` belongs to one event loop.

    hits, misses: how often a picture was given from here, and how often one had to be made.
    """

    def __init__(self, limit_bytes: int) -> None:
        self._limit = limit_bytes
        self._kept: OrderedDict[str, KeptPicture] = OrderedDict()
        self._nbytes = 0
        self._lock = threading.Lock()
        self.hits = 0
        self.misses = 0
        self._making: dict[str, tuple[asyncio.Lock, int]] = {}

    def get(self, tag: str) -> KeptPicture | None:
        """The picture with this tag, if it is kept."""
        with self._lock:
            found = self._kept.get(tag)
            if found is not None:
                self._kept.move_to_end(tag)
                self.hits += 1
        return found

    def put(self, tag: str, picture: KeptPicture) -> None:
        """Keep a picture, unless it alone is too large."""
        if picture.nbytes > self._limit:
            return
        with self._lock:
            before = self._kept.pop(tag, None)
            self._nbytes += picture.nbytes - (before.nbytes if before else 0)
            self._kept[tag] = picture
            while self._nbytes > self._limit:
                self._nbytes -= self._kept.popitem(last=False)[1].nbytes

    @property
    def nbytes(self) -> int:
        """About what all of it takes in memory."""
        return self._nbytes

    @asynccontextmanager
    async def alone(self, tag: str, limit_s: float) -> AsyncIterator[KeptPicture | None]:
        """One at a time makes the picture with this tag, which gets None; the others wait, and then find it kept and get it.

        Raises BusyError when that takes longer than `limit_s`, as where it is not kept and many ask for it.
        """
        lock, count = self._making.get(tag, (asyncio.Lock(), 0))
        self._making[tag] = lock, count + 1
        try:
            try:
                await (asyncio.wait_for(lock.acquire(), limit_s) if count else lock.acquire())
            except TimeoutError:
                raise BusyError(TOO_LATE) from None
            try:
                found = self.get(tag)
                self.misses += found is None
                yield found
            finally:
                lock.release()
        finally:
            count = self._making[tag][1] - 1
            if count:
                self._making[tag] = lock, count
            else:
                del self._making[tag]
