"""Slow answers that need no cleverness, to check the fast ones against."""

from __future__ import annotations

from fractions import Fraction
from itertools import combinations, pairwise

import numpy as np

from geometry.predicates import front_facing
from geometry.topology import build_edges
from tests.rays import layers


def silhouette(positions, faces, eye):
    """(s, 2) i4 directed silhouette edges of a closed mesh by the facing rule."""
    table = build_edges(faces)
    front = front_facing(positions, faces, eye)
    left, right = front[table.faces[:, 0]], front[table.faces[:, 1]]
    return np.ascontiguousarray(np.concatenate([table.vertices[left & ~right], table.vertices[right & ~left][:, ::-1]]), np.int32)


def _crossing_heights(a, b):
    (ax, ay, bx, by), (cx, cy, dx, dy) = a, b
    area = (bx - ax) * (dy - cy) - (by - ay) * (dx - cx)
    if area == 0:
        return []
    t = ((cx - ax) * (dy - cy) - (cy - ay) * (dx - cx)) / area
    return [ay + t * (by - ay)] if 0 <= t <= 1 else []


def positive_area(segments, width, height):
    """(h, w) f8: the area of each pixel where the winding number is positive, in rational arithmetic."""
    lines = [tuple(Fraction(float(c)) for c in s) for s in segments]
    sides = [(Fraction(x), Fraction(-(10**12)), Fraction(x), Fraction(10**12)) for x in range(width + 1)]
    heights = {Fraction(y) for y in range(height + 1)}
    for a in lines:
        heights.update((a[1], a[3]))
        for side in sides:
            heights.update(_crossing_heights(a, side))
    for a, b in combinations(lines, 2):
        heights.update(_crossing_heights(a, b))
    area = [[Fraction(0)] * width for _ in range(height)]
    ordered = sorted(y for y in heights if 0 <= y <= height)
    for top, bottom in pairwise(ordered):
        middle = (top + bottom) / 2
        for column, covered in enumerate(_covered_columns(lines, middle, width)):
            area[int(middle)][column] += covered * (bottom - top)
    return np.array(area, np.float64)


def _covered_columns(lines, y, width):
    crossings = sorted((xa + (y - ya) * (xb - xa) / (yb - ya), 1 if yb > ya else -1) for xa, ya, xb, yb in lines if (ya < y) != (yb < y))
    covered, winding, before = [Fraction(0)] * width, 0, None
    for x, rise in crossings:
        if winding > 0:
            for column in range(max(0, int(before) - 1), min(width, int(x) + 1)):
                covered[column] += max(Fraction(0), min(x, Fraction(column + 1)) - max(before, Fraction(column)))
        winding, before = winding + rise, x
    return covered


def covered_by_rays(view, positions, faces, samples):
    """(h, w) f8: part of samples^2 rays of each pixel that meet a front-facing face in front of the eye. Any eye, any pose."""
    front, _ = layers(view, positions, faces, samples)
    return (front > 0).reshape(view.height, samples, view.width, samples).mean(axis=(1, 3))


def supersampled(pixels, faces, width, height, samples):
    """(h, w) f8: part of samples^2 points of each pixel that some face covers; pixels (v, 2) f8, nothing behind the eye.

    Row by row of points: each face covers a span of them, which is a step up and a step down.
    """
    corners = pixels[faces] * samples - 0.5
    first = np.maximum(np.ceil(corners[:, :, 1].min(axis=1)).astype(int), 0)
    last = np.minimum(np.floor(corners[:, :, 1].max(axis=1)).astype(int), height * samples - 1)
    count = np.maximum(last - first + 1, 0)
    face = np.repeat(np.arange(len(faces)), count)
    row = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count) + first[face]
    low, high = np.full(len(row), np.inf), np.full(len(row), -np.inf)
    for k in range(3):
        a, b = corners[face, k], corners[face, (k + 1) % 3]
        crossed = (a[:, 1] <= row) != (b[:, 1] <= row)
        a, b = a[crossed], b[crossed]
        x = a[:, 0] + (row[crossed] - a[:, 1]) * (b[:, 0] - a[:, 0]) / (b[:, 1] - a[:, 1])
        low[crossed], high[crossed] = np.minimum(low[crossed], x), np.maximum(high[crossed], x)
    some = low < high
    begin, end = (np.clip(np.ceil(x[some]).astype(int), 0, width * samples) for x in (low, high))
    order, across = np.argsort(row[some], kind="stable"), width * samples + 1
    steps, begin, end = row[some][order], begin[order], end[order]
    bounds = np.searchsorted(steps, np.arange(height + 1) * samples)
    covered = np.empty((height, width))
    for y in range(height):
        here = slice(bounds[y], bounds[y + 1])
        at = (steps[here] % samples) * across
        change = np.bincount(at + begin[here], minlength=samples * across) - np.bincount(at + end[here], minlength=samples * across)
        points = np.cumsum(change.reshape(samples, across), axis=1)[:, :-1] > 0
        covered[y] = points.reshape(samples, width, samples).mean(axis=(0, 2))
    return covered
