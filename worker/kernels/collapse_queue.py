"""A binary heap of edges with positions: each edge is in it at most once, so it never grows and nothing in it is stale."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from geometry.borrowing import borrowing


class EdgeQueue(NamedTuple):
    """key: (e,) f8. slot: (e,) i4, place in the heap, -1 when outside. heap: (e,) i4 edges. size: (1,) i8."""

    key: np.ndarray
    slot: np.ndarray
    heap: np.ndarray
    size: np.ndarray


def empty_queue(edge_count: int) -> EdgeQueue:
    """A queue for edges 0 ... edge_count - 1 with nothing in it."""
    return EdgeQueue(
        np.full(edge_count, np.inf),
        np.full(edge_count, -1, np.int32),
        np.empty(edge_count, np.int32),
        np.zeros(1, np.int64),
    )


@borrowing
def _up(queue, i):
    key, slot, heap = queue.key, queue.slot, queue.heap
    e = heap[i]
    k = key[e]
    while i > 0:
        parent = (i - 1) >> 1
        other = heap[parent]
        if key[other] < k or (key[other] == k and other < e):
            break
        heap[i] = other
        slot[other] = i
        i = parent
    heap[i] = e
    slot[e] = i


@borrowing
def _down(queue, i):
    key, slot, heap = queue.key, queue.slot, queue.heap
    n = queue.size[0]
    e = heap[i]
    k = key[e]
    while True:
        child = 2 * i + 1
        if child >= n:
            break
        other = heap[child]
        if child + 1 < n:
            right = heap[child + 1]
            if key[right] < key[other] or (key[right] == key[other] and right < other):
                other = right
                child += 1
        if k < key[other] or (k == key[other] and e < other):
            break
        heap[i] = other
        slot[other] = i
        i = child
    heap[i] = e
    slot[e] = i


@borrowing
def put(queue, e, key):
    """Insert edge e, or move it to its new key; an infinite key takes it out. Equal keys are served by edge number."""
    if key == np.inf:
        remove(queue, e)
        return
    old = queue.key[e]
    queue.key[e] = key
    i = queue.slot[e]
    if i < 0:
        i = queue.size[0]
        queue.size[0] += 1
        queue.heap[i] = e
        _up(queue, i)
    elif key < old:
        _up(queue, i)
    else:
        _down(queue, i)


@borrowing
def remove(queue, e):
    """Take edge e out, if it is in."""
    i = queue.slot[e]
    queue.key[e] = np.inf
    if i < 0:
        return
    queue.slot[e] = -1
    queue.size[0] -= 1
    last = queue.heap[queue.size[0]]
    if last != e:
        queue.heap[i] = last
        queue.slot[last] = i
        _up(queue, i)
        _down(queue, queue.slot[last])
