"""Brute force about strokes: winding numbers of polygons, triangles, and distances from discs along a line."""

from __future__ import annotations

from itertools import pairwise

import numpy as np


def polygons_of(places, offsets):
    """The polygons of outlines."""
    return [places[a:b] for a, b in pairwise(offsets.tolist())]


def winding(polygons, points):
    """(n,) int: how often closed polygons, together, go round points (n, 2)."""
    total = np.zeros(len(points), int)
    x, y = points.T
    for polygon in polygons:
        for (ax, ay), (bx, by) in zip(polygon, np.roll(polygon, -1, axis=0), strict=True):
            if ay == by:
                continue
            crosses = ((ay <= y) & (by > y)) | ((by <= y) & (ay > y))
            right = ax + (y - ay) / (by - ay) * (bx - ax) > x
            total += np.where(crosses & right, 1 if by > ay else -1, 0)
    return total


def in_triangles(vertices, indices, points):
    """(n,) bool: whether points (n, 2) are in some triangle."""
    found = np.zeros(len(points), bool)
    for corners in vertices[indices.reshape(-1, 3), :2].astype(float):
        e = np.roll(corners, -1, axis=0) - corners
        turns = [e[k, 0] * (points[:, 1] - corners[k, 1]) - e[k, 1] * (points[:, 0] - corners[k, 0]) for k in range(3)]
        found |= (np.minimum.reduce(turns) >= 0) | (np.maximum.reduce(turns) <= 0)
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
    best = np.full(len(at), np.inf)
    for place, size in zip(places, sizes, strict=True):
        best = np.minimum(best, np.hypot(*(at - place).T) - size)
    return best


def arc_length(points, closed=False):
    """Pixels along a polyline."""
    ends = np.roll(points, -1, axis=0) if closed else points[1:]
    return float(np.linalg.norm(ends - points[: len(ends)], axis=1).sum())
