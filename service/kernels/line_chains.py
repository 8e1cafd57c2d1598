"""Pieces of lines as polylines, as long as can be: pieces of one kind, all in sight or all hidden, that end in the same place."""

from __future__ import annotations

import numpy as np
from numba import njit

from service.kernels.line_image import NEAR0, NEAR1, T0, T1, X0, X1, Y0, Y1

NOWHERE = -1
"""Node of an end that is a cut: nothing goes on there."""
STRAIGHT = 0.0
"""Where more than two pieces end, two are joined only if they turn by less than a right angle: the cosine of that."""


@njit(cache=True, nogil=True)
def runs_of(lines, nodes, kinds, line, spans, seen):
    """(points (r, 2, 3) f8, at (r, 2) i4, kind (r,) u1, in_sight (r,) bool): pieces of a line that follow one another and are alike as one.

    points: both ends in pixels, and how near they are (`line_image.NEAR0`); at: the nodes there. line, spans: `line_pieces.cut_lines`;
    seen: `line_sight.pieces_in_sight`.
    """
    count = line.shape[0]
    points, at = np.empty((count, 2, 3)), np.empty((count, 2), np.int32)
    kind, in_sight = np.empty(count, np.uint8), np.empty(count, np.bool_)
    runs, i = 0, 0
    while i < count:
        j, n = i, line[i]
        while j + 1 < count and line[j + 1] == n and seen[j + 1] == seen[i]:
            j += 1
        for end in range(2):
            s = spans[j, 1] if end else spans[i, 0]
            x0, y0, x1, y1 = lines[n, X0], lines[n, Y0], lines[n, X1], lines[n, Y1]
            whole = s == 1.0 if end else s == 0.0
            points[runs, end, 0] = (x1 if end else x0) if whole else x0 + s * (x1 - x0)
            points[runs, end, 1] = (y1 if end else y0) if whole else y0 + s * (y1 - y0)
            points[runs, end, 2] = lines[n, NEAR0] + s * (lines[n, NEAR1] - lines[n, NEAR0])
            ends_there = lines[n, T1] == 1.0 if end else lines[n, T0] == 0.0
            at[runs, end] = nodes[n, end] if whole and ends_there else NOWHERE
        kind[runs], in_sight[runs] = kinds[n], seen[i]
        runs += 1
        i = j + 1
    return points[:runs].copy(), at[:runs].copy(), kind[:runs].copy(), in_sight[:runs].copy()


@njit(cache=True, nogil=True)
def _cosine(points, one, two):
    """How straight two ends of runs, 2 r + end, go on into each other: 1 for straight on, -1 for back."""
    a, b = one // 2, two // 2
    ax, ay = points[a, 1, 0] - points[a, 0, 0], points[a, 1, 1] - points[a, 0, 1]
    bx, by = points[b, 1, 0] - points[b, 0, 0], points[b, 1, 1] - points[b, 0, 1]
    if one % 2 == 0:
        ax, ay = -ax, -ay
    if two % 2 == 1:
        bx, by = -bx, -by
    return (ax * bx + ay * by) / max(np.hypot(ax, ay) * np.hypot(bx, by), 1e-300)


@njit(cache=True, nogil=True)
def _mates(points, order, keys):
    """(2 r,) i4: the end that each end goes on in, NOWHERE for none. order: ends, so that those with the same key lie together."""
    mates = np.full(keys.shape[0], NOWHERE, np.int32)
    i = 0
    while i < order.shape[0]:
        j = i
        while j < order.shape[0] and keys[order[j]] == keys[order[i]]:
            j += 1
        if keys[order[i]] >= 0 and j - i == 2:
            mates[order[i]], mates[order[i + 1]] = order[i + 1], order[i]
        elif keys[order[i]] >= 0:
            while True:
                best, one, two = STRAIGHT, NOWHERE, NOWHERE
                for k in range(i, j):
                    for m in range(i, k):
                        if mates[order[k]] == NOWHERE and mates[order[m]] == NOWHERE:
                            cosine = _cosine(points, order[k], order[m])
                            if cosine > best:
                                best, one, two = cosine, order[k], order[m]
                if one == NOWHERE:
                    break
                mates[one], mates[two] = two, one
        i = j
    return mates


@njit(cache=True, nogil=True)
def chain(points, at, kind, in_sight):
    """(ends (r,) i4, offsets (l + 1,) i4, closed (l,) bool): the runs of `runs_of` as polylines that use each run once.

    Polyline i is the runs ends[offsets[i]:offsets[i + 1]] // 2 one after the other, each from its end ends % 2 to the other.
    """
    runs = at.shape[0]
    keys = np.empty(2 * runs, np.int64)
    for r in range(runs):
        for end in range(2):
            group = 2 * np.int64(kind[r]) + in_sight[r]
            keys[2 * r + end] = NOWHERE if at[r, end] == NOWHERE else np.int64(at[r, end]) * 64 + group
    mates = _mates(points, np.argsort(keys, kind="mergesort"), keys)
    used, ends = np.zeros(runs, np.bool_), np.empty(runs, np.int32)
    offsets, closed = np.zeros(runs + 1, np.int32), np.zeros(runs, np.bool_)
    written, chains = 0, 0
    for loops in range(2):  # first those with an end, from there; then what is left goes round
        for start in range(2 * runs):
            if used[start // 2] or (loops == 0 and mates[start] != NOWHERE):
                continue
            end = start
            while end != NOWHERE and not used[end // 2]:
                used[end // 2] = True
                ends[written] = end
                written += 1
                end = mates[end ^ 1]
            closed[chains] = loops == 1
            chains += 1
            offsets[chains] = written
    return ends, offsets[: chains + 1].copy(), closed[:chains].copy()


@njit(cache=True, nogil=True)
def polylines(points, at, ends, offsets, closed):
    """(places (n, 3) f8, nodes (n,) i4, starts (l + 1,) i4): the points of the polylines; of a closed one the first is not repeated."""
    total = ends.shape[0] + offsets.shape[0]
    places, nodes, starts = np.empty((total, 3)), np.empty(total, np.int32), np.zeros(offsets.shape[0], np.int32)
    n = 0
    for i in range(offsets.shape[0] - 1):
        for k in range(offsets[i], offsets[i + 1]):
            run, end = ends[k] // 2, ends[k] % 2
            places[n], nodes[n] = points[run, end], at[run, end]
            n += 1
        if not closed[i]:
            run, end = ends[offsets[i + 1] - 1] // 2, 1 - ends[offsets[i + 1] - 1] % 2
            places[n], nodes[n] = points[run, end], at[run, end]
            n += 1
        starts[i + 1] = n
    return places[:n].copy(), nodes[:n].copy(), starts
