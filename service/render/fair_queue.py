"""A bounded queue that is fair to those who fill it: owners take turns, and who waits longest in line makes room.

Based on: Nagle, RFC 970 (queues taken in turn), and McKenney, Stochastic Fairness Queuing, 1990 (what is full drops from the longest).
"""

from __future__ import annotations

import threading
from collections import OrderedDict, deque
from typing import Generic, TypeVar

T = TypeVar("T")


class FullError(Exception):
    """There is no room, and nobody has more waiting than the one who came."""


class FairQueue(Generic[T]):
    """At most `depth` items, taken in turn from their owners, each owner's in the order they came. For any number of threads."""

    def __init__(self, depth: int) -> None:
        self.depth = depth
        self._waiting: OrderedDict[str, deque[T]] = OrderedDict()
        self._count = 0
        self._closed = False
        self._changed = threading.Condition()

    def __len__(self) -> int:
        return self._count

    def put(self, owner: str, item: T) -> T | None:
        """Let an item wait. When there is no room the last one of whoever has most waiting gives way, and is returned.

        Raises FullError when that would be of the same owner, or of one with no more than this item more.
        """
        with self._changed:
            dropped = self._make_room(owner) if self._count >= self.depth else None
            self._waiting.setdefault(owner, deque()).append(item)
            self._count += 1
            self._changed.notify()
        return dropped

    def take(self) -> T | None:
        """The next item, once there is one; None when the queue is closed."""
        with self._changed:
            while not self._count and not self._closed:
                self._changed.wait()
            if not self._count:
                return None
            owner, items = next(iter(self._waiting.items()))
            item = items.popleft()
            self._count -= 1
            if items:
                self._waiting.move_to_end(owner)
            else:
                del self._waiting[owner]
            return item

    def close(self) -> list[T]:
        """What waits; from now on there is nothing to take."""
        with self._changed:
            left = [item for items in self._waiting.values() for item in items]
            self._waiting.clear()
            self._count, self._closed = 0, True
            self._changed.notify_all()
        return left

    def _make_room(self, owner: str) -> T:
        longest = max(self._waiting, key=lambda name: len(self._waiting[name]), default=owner)
        own = len(self._waiting.get(owner, ()))
        if longest == owner or len(self._waiting[longest]) <= own + 1:
            raise FullError
        self._count -= 1
        return self._waiting[longest].pop()
