"""The collapse loop of the progressive hull: cheapest edge first, in pieces short enough to report progress between them.

Based on: Silhouette Clipping, section 3; kernels of the neighbourhood, the placement and the queue are beside this file.
An edge waits in the queue under the volume its collapse is known to cost at least: the exact test, the shape tests and, when
they fail, the dearer placements are made when it comes to the front.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from geometry.borrowing import borrowing
from worker.kernels.collapse_mesh import (
    collapse,
    following,
    gather_fan,
    keeps_topology,
    preceding,
)
from worker.kernels.collapse_place import (
    best_outside,
    best_unfolded,
    corner_cost,
    encloses,
    measure_fan,
    well_shaped,
)
from worker.kernels.collapse_queue import put, remove

SHAPE = 1e-3
"""Weight of (edge length)^3 beside the volume gained: keeps faces round where volumes are much alike."""
FREE = 1e-18
"""The same weight for edges that cost nothing: below any volume that rounding a vertex to float32 can gain."""
HASTE = 0.5
"""An edge whose surroundings changed waits under this part of its old cost, and is costed anew when it comes to the front.

Measured against costing it at once: half the time, hulls as tight. Under its whole old cost: a third, but 3 % more excess.
"""

WIDE = 64
"""Edges at a vertex beyond which they are not all costed anew whenever one face beside the vertex changes: see `_is_due`."""

CURSOR, COLLAPSES, MARK, WORK, STEPS = 0, 1, 2, 3, 4  # places in Progress.counters
DONE, GOING, REACHED, FULL = 0, 1, 2, 3
"""What `advance` says: nothing is left to collapse, there is more to do, as few faces as asked for, no more volume is allowed."""
_ROUNDING_TRIES = (1.0, 4.0)  # rounding margins for a second and a third try


class Progress(NamedTuple):
    """counters: (5,) i8 (next edge to cost at the start, collapses made, last mark, edges costed, steps recorded). state of the e
    edges: target (e, 3) f8 new vertex, stale (e,) bool, seen (e,) i8. Record of s steps, collapses and moves: vertices (s, 2) i4,
    positions (s, 3) f4, volume (s,) f8 gained. gained (1,) f8: the sum of that so far.
    """

    counters: np.ndarray
    target: np.ndarray
    stale: np.ndarray
    seen: np.ndarray
    vertices: np.ndarray
    positions: np.ndarray
    volume: np.ndarray
    gained: np.ndarray


def new_progress(edge_count: int, face_count: int) -> Progress:
    """Nothing done yet."""
    limit = face_count // 2
    return Progress(
        np.zeros(5, np.int64),
        np.zeros((edge_count, 3)),
        np.zeros(edge_count, np.bool_),
        np.zeros(edge_count, np.int64),
        np.empty((limit, 2), np.int32),
        np.empty((limit, 3), np.float32),
        np.empty(limit),
        np.zeros(1),
    )


@borrowing
def _gather(mesh, place, h):
    """Gather and measure the fan of h; (0, 0) when the edge cannot be collapsed whatever its vertex."""
    a, b = mesh.corner[h], mesh.corner[following(h)]
    if mesh.locked[a] or mesh.locked[b]:
        return 0, 0
    count, count_a = gather_fan(mesh.opposite, h, place.fan)
    if count <= 0 or not measure_fan(mesh, place, count):
        return 0, 0
    return count, count_a


@borrowing
def _key(mesh, h, cost):
    """Place in the queue: by volume and a little by length; what costs nothing comes first, short edges before long ones."""
    p, q = mesh.positions[mesh.corner[h]], mesh.positions[mesh.corner[following(h)]]
    square = (p[0] - q[0]) ** 2 + (p[1] - q[1]) ** 2 + (p[2] - q[2]) ** 2
    length = square * np.sqrt(square)
    return cost + SHAPE * length if cost > 0.0 else FREE * length


@borrowing
def _keep_target(progress, place, e):
    for k in range(3):
        progress.target[e, k] = place.point[k]


@borrowing
def _cost(mesh, queue, progress, place, e):
    """Cost edge e anew and put it in its place."""
    progress.stale[e] = False
    progress.counters[WORK] += 1
    h = mesh.half[e]
    count, count_a = _gather(mesh, place, h)
    if count == 0:
        remove(queue, e)
        return
    best = np.inf
    for end in range(2):
        cost = corner_cost(mesh, place, count, count_a, end)
        if cost < best:
            best = cost
            _keep_target(progress, place, e)
    if best > 0.0:
        cost = best_outside(place, count, 1.0)
        if cost < best:
            best = cost
            _keep_target(progress, place, e)
    put(queue, e, _key(mesh, h, best))


@borrowing
def _accepts(mesh, place, count, count_a):
    return well_shaped(mesh, place, count, count_a) and encloses(mesh, place, count)


@borrowing
def _second_choice(mesh, progress, place, e, count, count_a):
    """Cheapest dearer placement that is accepted, kept as the target; returns its cost."""
    best = np.inf
    for end in range(2):
        cost = corner_cost(mesh, place, count, count_a, end)
        if cost < best and _accepts(mesh, place, count, count_a):
            best = cost
            _keep_target(progress, place, e)
    for widen in _ROUNDING_TRIES:
        cost = best_unfolded(mesh, place, count, count_a, widen)
        if cost >= best:
            break
        if _accepts(mesh, place, count, count_a):
            best = cost
            _keep_target(progress, place, e)
            break
    return best


@borrowing
def _front(mesh, queue, progress, place, e, most_gained):
    """Treat the edge at the front: collapse it, send it back under a new key, or drop it; False when it would gain too much."""
    h = mesh.half[e]
    count, count_a = _gather(mesh, place, h)
    progress.counters[MARK] += 1
    if count == 0 or not keeps_topology(mesh, place.fan, count, count_a, progress.counters[MARK]):
        remove(queue, e)
        return True
    for k in range(3):
        place.point[k] = progress.target[e, k]
    if not _accepts(mesh, place, count, count_a):
        cost = _second_choice(mesh, progress, place, e, count, count_a)
        if cost == np.inf:
            remove(queue, e)
        else:
            # never below the old key: the front would not advance
            put(queue, e, max(queue.key[e], _key(mesh, h, cost)))
        return True
    volume = volume_gained(mesh, place, count)
    if progress.gained[0] + volume > most_gained:
        return False
    _commit(mesh, queue, progress, place, e, count, count_a, volume)
    return True


@borrowing
def _commit(mesh, queue, progress, place, e, count, count_a, volume):
    h = place.fan[0]
    a, b = mesh.corner[h], mesh.corner[following(h)]
    step = progress.counters[STEPS]
    progress.vertices[step, 0], progress.vertices[step, 1] = a, b
    progress.volume[step] = volume
    progress.gained[0] += volume
    for k in range(3):
        mesh.positions[a, k] = place.point[k]
        progress.positions[step, k] = place.point[k]
    progress.counters[COLLAPSES] += 1
    progress.counters[STEPS] += 1
    lost = collapse(mesh, place.fan, count, count_a)
    remove(queue, e)
    remove(queue, lost[0])
    remove(queue, lost[1])
    _renew(mesh, queue, progress, place, a)


@borrowing
def _postpone(mesh, queue, progress, place, e):
    """Have edge e costed soon; at once when it could not be collapsed so far."""
    if queue.slot[e] < 0:
        _cost(mesh, queue, progress, place, e)
    elif not progress.stale[e]:
        progress.stale[e] = True
        put(queue, e, HASTE * queue.key[e])


@borrowing
def _is_due(mesh, start):
    """Whether all edges at the start of half-edge `start` are to be costed anew because a neighbour of it was collapsed into.

    Around a vertex of n edges that would be n costs of n faces for each of n collapses. A wide vertex is due when its edges have
    become a twelfth fewer; else only those of its edges are that go to a neighbour of that neighbour. Costs only order the queue.
    """
    n = 0
    g = start
    while True:
        n += 1
        g = mesh.opposite[preceding(g)]
        if g == start:
            break
    return n <= WIDE or np.int64(8.0 * np.log2(n)) != np.int64(8.0 * np.log2(n + 1))


@borrowing
def _renew(mesh, queue, progress, place, a):
    """Edges whose F(i+1) changed: those at a are costed now, those at its neighbours when they come to the front."""
    progress.counters[MARK] += 1
    mark = progress.counters[MARK]
    first = mesh.out[a]
    h = first
    while True:
        e = mesh.edge[h]
        progress.seen[e] = mark
        _cost(mesh, queue, progress, place, e)
        h = mesh.opposite[preceding(h)]
        if h == first:
            break
    while True:
        start = following(h)
        g = start
        all_around = _is_due(mesh, start)
        while True:
            e = mesh.edge[g]
            if progress.seen[e] != mark:
                progress.seen[e] = mark
                _postpone(mesh, queue, progress, place, e)
            g = mesh.opposite[preceding(g)]
            if g == start or not all_around:
                break
        h = mesh.opposite[preceding(h)]
        if h == first:
            break


@borrowing
def volume_gained(mesh, place, count):
    """Sum of the tetrahedra from place.point to the faces of the fan, term by term (all are at least zero)."""
    local, point = place.local, place.point
    total = 0.0
    for k in range(count):
        v = mesh.positions[mesh.corner[place.fan[k]]]
        x, y, z = point[0] - v[0], point[1] - v[1], point[2] - v[2]
        total += max(0.0, place.area[k, 0] * x + place.area[k, 1] * y + place.area[k, 2] * z)
    return total * local[3] * local[3] / 6.0


@borrowing
def advance(mesh, queue, progress, place, work, least_faces, most_gained):
    """Go on until about `work` more edges are costed, at most least_faces are left, or the cheapest edge would gain so much
    volume that the sum exceeds most_gained; returns DONE, GOING, REACHED or FULL.
    """
    counters = progress.counters
    end = counters[WORK] + work
    while counters[CURSOR] < mesh.half.shape[0]:
        if counters[WORK] >= end:
            return GOING
        if mesh.half[counters[CURSOR]] >= 0:
            _cost(mesh, queue, progress, place, counters[CURSOR])
        counters[CURSOR] += 1
    while queue.size[0] > 0:
        if mesh.corner.shape[0] // 3 - 2 * counters[COLLAPSES] <= least_faces:
            return REACHED
        if counters[WORK] >= end:
            return GOING
        e = queue.heap[0]
        if progress.stale[e]:
            _cost(mesh, queue, progress, place, e)
        else:
            counters[WORK] += 1
            if not _front(mesh, queue, progress, place, e, most_gained):
                return FULL
    return DONE
