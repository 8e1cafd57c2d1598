"""A bounded queue that is fair to those who fill it: owners take turns, and who has the longest line makes room.

Based on: Nagle, RFC 970 (queues taken in turn), and McKenney, Stochastic Fairness Queuing, 1990 (what is full drops from the longest). In
a line what is due first comes first, which makes short work pass long work that is due later: Bender, Chakrabarti and Muthukrishnan, Flow
and Stretch Metrics for Scheduling Continuous Job Streams, SODA 1998.
"""

from __future__ import annotations

import threading
from bisect import insort
from collections import OrderedDict
from collections.abc import Iterable
from typing import Generic, NamedTuple, TypeVar

T = TypeVar("T")


class FullError(Exception):
    """There is no room, and nobody has more waiting than the one who came."""


class _Place(NamedTuple, Generic[T]):
    item: T
    promised: bool
    due: float


class FairQueue(Generic[T]):
    """At most `depth` items and those that were promised a place, taken in turn from their owners, of each owner the one that is due first,
    and those that are due at the same time in the order they came. For any number of threads."""

    def __init__(self, depth: int) -> None:
        self.depth = depth
        self._lines: OrderedDict[str, list[_Place[T]]] = OrderedDict()
        self._closed = False
        self._changed = threading.Condition()

    def __len__(self) -> int:
        """Items that count."""
        with self._changed:
            return sum(map(_counted, self._lines.values()))

    def put(self, owner: str, item: T, *, promised: bool = False, due: float | None = None) -> T | None:
        """Let an item wait. When there is no room the last one of whoever has most waiting gives way, and is returned.

        promised: it has a place whatever waits, does not count, and never gives way. due: a time on a clock of the callers'; if not
        given, it comes after all that this owner has waiting. Raises FullError when what would give way is of the same owner, or of one
        with no more than this item more.
        """
        with self._changed:
            dropped = None if promised or len(self) < self.depth else self._make_room(owner)
            line = self._lines.setdefault(owner, [])
            latest = line[-1].due if line else float("-inf")
            insort(line, _Place(item, promised, latest if due is None else due), key=lambda place: place.due)
            self._changed.notify()
        return dropped

    def take(self) -> T | None:
        """The next item, once there is one; None when the queue is closed."""
        with self._changed:
            while not self._lines and not self._closed:
                self._changed.wait()
            if not self._lines:
                return None
            owner, line = next(iter(self._lines.items()))
            place = line.pop(0)
            self._lines.move_to_end(owner)
            self._forget_if_empty(owner)
            return place.item

    def close(self) -> list[T]:
        """What waits; from now on there is nothing to take."""
        with self._changed:
            left = [place.item for line in self._lines.values() for place in line]
            self._lines.clear()
            self._closed = True
            self._changed.notify_all()
        return left

    def _make_room(self, owner: str) -> T:
        longest = max(self._lines, key=lambda name: _counted(self._lines[name]), default=owner)
        own, most = _counted(self._lines.get(owner, ())), _counted(self._lines.get(longest, ()))
        if longest == owner or most <= own + 1:
            raise FullError
        line = self._lines[longest]
        last = max(number for number, place in enumerate(line) if not place.promised)
        dropped = line.pop(last)
        self._forget_if_empty(longest)
        return dropped.item

    def _forget_if_empty(self, owner: str) -> None:
        if not self._lines[owner]:
            del self._lines[owner]


def _counted(line: Iterable[_Place[T]]) -> int:
    return sum(not place.promised for place in line)
