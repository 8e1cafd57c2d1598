"""Brute force about strokes: winding numbers of polygons, triangles, and distances from discs along a line."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numba import njit


def polygons_of(places, offsets):
    """The polygons of outlines."""
    return [places[a:b] for a, b in pairwise(offsets.tolist())]


def winding(polygons, points):
    """(n,) int: how often closed polygons, together, go round points (n, 2)."""
    rising = np.argsort(points[:, 1], kind="stable")
    ordered, turns, total = np.ascontiguousarray(points[rising], np.float64), np.zeros(len(points), int), np.empty(len(points), int)
    for polygon in polygons:
        _wind(np.asarray(polygon, np.float64), ordered, turns)
    total[rising] = turns
    return total


@njit(cache=True)
def _wind(polygon, points, turns):
    """Add how often one polygon goes round each of the points, which are in the order of y: edges to the right, at the point's height."""
    heights = points[:, 1].copy()
    for k in range(len(polygon)):
        (ax, ay), (bx, by) = polygon[k], polygon[(k + 1) % len(polygon)]
        for n in range(np.searchsorted(heights, min(ay, by)), np.searchsorted(heights, max(ay, by))):
            x, y = points[n]
            if ax + (y - ay) / (by - ay) * (bx - ax) > x:
                turns[n] += 1 if by > ay else -1


def in_triangles(vertices, indices, points):
    """(n,) bool: whether points (n, 2) are in some triangle."""
    return _in_triangles(vertices[indices.reshape(-1, 3), :2].astype(float), np.asarray(points, np.float64))


@njit(cache=True)
def _in_triangles(triangles, points):
    found = np.zeros(len(points), np.bool_)
    for f in range(len(triangles)):
        (ax, ay), (bx, by), (cx, cy) = triangles[f, 0], triangles[f, 1], triangles[f, 2]
        for n in range(len(points)):
            x, y = points[n]
            u = (bx - ax) * (y - ay) - (by - ay) * (x - ax)
            v = (cx - bx) * (y - by) - (cy - by) * (x - bx)
            w = (ax - cx) * (y - cy) - (ay - cy) * (x - cx)
            if min(u, v, w) >= 0.0 or max(u, v, w) <= 0.0:
                found[n] = True
    return found


def along(points, values, closed, step=0.05):
    """(places (m, 2), values (m,)): about every `step` pixels of a polyline."""
    places, found = [], []
    for k in range(len(points) if closed else len(points) - 1):
        j = (k + 1) % len(points)
        count = max(2, int(np.linalg.norm(points[j] - points[k]) / step))
        t = np.linspace(0.0, 1.0, count)[:, None]
        places.append(points[k] + t * (points[j] - points[k]))
        found.append(values[k] + t[:, 0] * (values[j] - values[k]))
    return np.concatenate(places), np.concatenate(found)


def beyond_discs(points, radii, closed, at):
    """(n,) f8: how far points `at` (n, 2) are from the nearest border of a disc along the polyline, below 0 inside."""
    places, sizes = along(points, radii, closed)
    return _beyond(places, sizes, np.asarray(at, np.float64))


@njit(cache=True)
def _beyond(places, sizes, at):
    best = np.full(len(at), np.inf)
    for n in range(len(at)):
        for k in range(len(places)):
            best[n] = min(best[n], np.hypot(at[n, 0] - places[k, 0], at[n, 1] - places[k, 1]) - sizes[k])
    return best


def arc_length(points, closed=False):
    """Pixels along a polyline."""
    ends = np.roll(points, -1, axis=0) if closed else points[1:]
    return float(np.linalg.norm(ends - points[: len(ends)], axis=1).sum())
