"""Locks that hold over machines, as objects in an S3 store that are only ever replaced conditionally.

A lock is an object that says who holds it. Its holder replaces it every few seconds, so that it is seen to live; whoever waits takes
it over once it has been the same for `TTL_S` by the waiter's own clock. Clocks of machines are never compared. Processes that share a
data folder wait for each other by locked files there before they ask the store (`backend.s3_store`), so to them a lock of one of
their own is a dead one's, and is taken over at once. A lock that is let go
says so, and is not deleted: a deletion cannot be made conditional, a replacement can (`If-Match`).

A holder that cannot renew in time, since it was stopped or cut off, does not know whether it still holds. So it writes nothing any
more once its last renewal is `SAFE_S` ago (`Leases.check`, before every writing request); a request it made just before that has
ended, or been given up, before anybody else can hold. What is left is a process that is stopped between that check and its request
for longer than the rest of the time: why that does no harm, `backend.records` says.
"""

from __future__ import annotations

import json
import logging
import random
import secrets
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

from backend.s3_client import ChangedError, S3Client
from schemas.errors import NotFoundError, SilhouetteError, StoreUnavailableError

log = logging.getLogger(__name__)

TTL_S = 15.0
"""A lock that nobody has renewed for so long may be taken over."""
RENEW_S = 3.0
SAFE_S = 8.0
"""A holder writes nothing later than this after its last renewal began; twice `s3_client.QUICK_S` fits between this and TTL_S."""
FIRST_WAIT_S, LAST_WAIT_S = 0.02, 0.5


@dataclass
class _Lease:
    key: str
    owner: str
    tag: str
    renewed_s: float
    lost: bool = False
    ended: threading.Event = field(default_factory=threading.Event)


class Leases:
    """The locks of a store. A thread may hold several at once.

    home: names those who never hold the same lock at once for another reason than one's death.
    """

    def __init__(self, client: S3Client, folder: str, home: str) -> None:
        self._client = client
        self._folder = folder
        self._home = home
        self._held = threading.local()

    @contextmanager
    def held(self, name: str) -> Iterator[None]:
        """Hold the lock of this name. Waits as long as another lives that does. Raises StoreUnavailableError."""
        lease = self._acquired(f"{self._folder}{name}")
        renewing = threading.Thread(target=self._renew, args=(lease,), name=f"lease-{name}", daemon=True)
        renewing.start()
        mine = self._of_thread()
        mine.append(lease)
        try:
            yield
        finally:
            mine.remove(lease)
            lease.ended.set()
            renewing.join()
            self._release(lease)

    def check(self) -> None:
        """Raise StoreUnavailableError when this thread holds a lock that may be somebody else's by now."""
        for lease in self._of_thread():
            if lease.lost or time.monotonic() - lease.renewed_s > SAFE_S:
                raise StoreUnavailableError("The object store could not be reached in time; try again in a moment.")

    def _content(self, owner: str | None) -> bytes:
        """What a lock's object says; never the same twice, so that its entity tag is not."""
        home = None if owner is None else self._home
        return json.dumps({"owner": owner, "home": home, "beat": secrets.token_hex(8)}).encode()

    def _of_thread(self) -> list[_Lease]:
        found: list[_Lease] | None = getattr(self._held, "leases", None)
        if found is None:
            found = self._held.leases = []
        return found

    def _acquired(self, key: str) -> _Lease:
        owner, wait_s = secrets.token_hex(16), FIRST_WAIT_S
        seen, seen_s = "", 0.0
        while True:
            asked_s = time.monotonic()
            try:
                data, tag = self._client.get(key)
            except NotFoundError:
                data, tag = b"", None
            holder, home = _parties(data)
            if holder == owner:  # an answer was lost
                assert tag is not None
                return _Lease(key, owner, tag, asked_s)
            if tag != seen:
                seen, seen_s = tag or "", asked_s
            if holder is None or home == self._home or asked_s - seen_s > TTL_S:
                if holder is not None:
                    log.warning("lock taken over: its holder is gone", extra={"lock": key})
                try:
                    return _Lease(key, owner, self._client.replace(key, self._content(owner), tag), asked_s)
                except ChangedError:
                    continue
            time.sleep(wait_s * random.uniform(0.5, 1.0))
            wait_s = min(LAST_WAIT_S, wait_s * 1.5)

    def _renew(self, lease: _Lease) -> None:
        while not lease.ended.wait(RENEW_S):
            asked_s = time.monotonic()
            try:
                lease.tag = self._client.replace(lease.key, self._content(lease.owner), lease.tag)
                lease.renewed_s = asked_s
            except ChangedError:
                if not self._still_mine(lease):
                    log.warning("lock lost", extra={"lock": lease.key})
                    lease.lost = True
                    return
            except SilhouetteError:
                log.warning("lock not renewed", extra={"lock": lease.key})

    def _still_mine(self, lease: _Lease) -> bool:
        """Whether it was this holder that changed the object: the answer to a renewal was lost. It counts as renewed when it is seen."""
        try:
            data, tag = self._client.get(lease.key)
        except SilhouetteError:
            return False
        lease.tag = tag
        return _parties(data)[0] == lease.owner

    def _release(self, lease: _Lease) -> None:
        if lease.lost:
            return
        try:
            self._client.replace(lease.key, self._content(None), lease.tag)
        except ChangedError:
            log.warning("lock lost", extra={"lock": lease.key})
        except SilhouetteError:  # it runs out
            log.warning("lock not released", extra={"lock": lease.key})


def _parties(data: bytes) -> tuple[str | None, str | None]:
    """(owner, home) of a lock's object; (None, None) of one that nobody holds."""
    try:
        found = json.loads(data)
        return found["owner"], found["home"]
    except (ValueError, KeyError, TypeError):
        return None, None
