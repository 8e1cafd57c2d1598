"""Brute force about lines: which points are hidden, by rays and by a depth buffer; where faces cross; distances of polylines."""

from __future__ import annotations

from itertools import combinations

import numpy as np
from numba import njit

NEXT, ON = 1e-5, 1e-12
"""Normalised units: what is nearer to a point than this may be the surface that the point is on, and certainly is."""
EDGE_ON = 1e-10
"""Sine: what is seen at a smaller angle is seen edge-on, and hides nothing."""
MARGIN = 1e-4
"""Barycentric: a ray so near to the border of a face may miss or meet it."""


def _rays(view, points):
    """(directions (n, 3) to the eye, how far it is in them)."""
    if view.orthographic:
        return np.tile(view.eye[:3], (len(points), 1)), np.full(len(points), np.inf)
    return view.eye[:3] - points, np.ones(len(points))


def hidden_by_rays(view, positions, faces, points):
    """(hidden (n,) bool, sure (n,) bool) of points (n, 3): every face tried for every point; not sure where a border decides."""
    directions, far = _rays(view, points)
    return _hidden(positions.astype(np.float64)[faces], np.asarray(points, np.float64), directions, far)


@njit(cache=True)
def _hidden(corners, points, directions, far):
    hidden, sure = np.zeros(len(points), np.bool_), np.ones(len(points), np.bool_)
    for n in range(len(points)):
        d = directions[n]
        length = np.sqrt((d * d).sum())
        for f in range(len(corners)):
            inner, along = _hit(corners[f], points[n], d, length)
            distance = along * length
            between = distance > NEXT and along < far[n]
            beside = ON < distance <= NEXT
            if between and inner > MARGIN:
                hidden[n] = sure[n] = True
                break
            if (between or beside) and inner > -MARGIN:
                sure[n] = False
    return hidden, sure


@njit(cache=True)
def _hit(triangle, point, d, length):
    """(inner, along): the least barycentric coordinate of where a ray meets a triangle's plane, and how far along d; nan edge-on."""
    (ax, ay, az), (bx, by, bz), (cx, cy, cz) = triangle[0], triangle[1], triangle[2]
    ux, uy, uz, vx, vy, vz = bx - ax, by - ay, bz - az, cx - ax, cy - ay, cz - az
    px, py, pz = d[1] * vz - d[2] * vy, d[2] * vx - d[0] * vz, d[0] * vy - d[1] * vx
    det = ux * px + uy * py + uz * pz
    if abs(det) <= EDGE_ON * np.sqrt(ux * ux + uy * uy + uz * uz) * np.sqrt(vx * vx + vy * vy + vz * vz) * length:
        return np.nan, np.nan
    sx, sy, sz = point[0] - ax, point[1] - ay, point[2] - az
    qx, qy, qz = sy * uz - sz * uy, sz * ux - sx * uz, sx * uy - sy * ux
    s, t = (sx * px + sy * py + sz * pz) / det, (qx * d[0] + qy * d[1] + qz * d[2]) / det
    return min(s, t, 1.0 - s - t), (vx * qx + vy * qy + vz * qz) / det


def depth_buffer(view, positions, faces, scale):
    """(h scale, w scale) f8: depth along the axis of what is nearest at each sample, inf where nothing is."""
    matrix = view.pixels[[0, 1, 3]]
    h = positions.astype(np.float64) @ matrix[:, :3].T + matrix[:, 3]
    depth = -(positions.astype(np.float64) @ view.view[2, :3] + view.view[2, 3])
    xy, near = h[:, :2] / h[:, 2:] * scale, depth if view.orthographic else 1.0 / depth
    buffer = np.full((view.height * scale, view.width * scale), np.inf)
    _fill(buffer, np.asarray(faces), xy, near, not view.orthographic)
    return buffer


@njit(cache=True)
def _fill(buffer, faces, xy, near, inverse):
    for f in range(len(faces)):
        i, j, k = faces[f]
        (ax, ay), (bx, by), (cx, cy) = xy[i], xy[j], xy[k]
        area = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
        if area == 0.0:
            continue
        for row in range(max(int(min(ay, by, cy)), 0), min(int(max(ay, by, cy)) + 1, buffer.shape[0])):
            for column in range(max(int(min(ax, bx, cx)), 0), min(int(max(ax, bx, cx)) + 1, buffer.shape[1])):
                x, y = column + 0.5, row + 0.5
                s = ((cx - x) * (ay - y) - (cy - y) * (ax - x)) / area
                t = ((ax - x) * (by - y) - (ay - y) * (bx - x)) / area
                if s >= 0.0 and t >= 0.0 and s + t <= 1.0:
                    z = near[i] + s * (near[j] - near[i]) + t * (near[k] - near[i])
                    buffer[row, column] = min(buffer[row, column], 1.0 / z if inverse else z)


def crossing_length(positions, faces):
    """Length of all segments in which two faces without a common vertex cross, in float64."""
    p, total = positions.astype(np.float64), 0.0
    low, high = p[faces].min(axis=1), p[faces].max(axis=1)
    near = (low[:, None] <= high).all(axis=2) & (low <= high[:, None]).all(axis=2)
    for f, g in np.argwhere(np.triu(near, 1)).tolist():
        if set(faces[f]) & set(faces[g]):
            continue
        hits = [*_hits(p[faces[f]], p[faces[g]]), *_hits(p[faces[g]], p[faces[f]])]
        if len(hits) >= 2:
            total += max(np.linalg.norm(a - b) for a, b in combinations(hits, 2))
    return total


def _hits(triangle, other):
    """Where the sides of one triangle go through another."""
    normal = np.cross(other[1] - other[0], other[2] - other[0])
    found = []
    for i in range(3):
        a, b = triangle[i], triangle[(i + 1) % 3]
        da, db = (a - other[0]) @ normal, (b - other[0]) @ normal
        if da * db >= 0.0:
            continue
        hit = a + da / (da - db) * (b - a)
        turns = [np.cross(other[(k + 1) % 3] - other[k], hit - other[k]) @ normal for k in range(3)]
        if min(turns) >= 0.0:
            found.append(hit)
    return found


def distance_to(polyline, closed, points):
    """(n,) f8 distances of points (n, 2) from a polyline."""
    ends = np.roll(polyline, -1, axis=0) if closed else polyline[1:]
    starts = polyline if closed else polyline[:-1]
    return _distances(np.asarray(starts, np.float64), np.asarray(ends, np.float64), np.asarray(points, np.float64))


@njit(cache=True)
def _distances(starts, ends, points):
    best = np.full(len(points), np.inf)
    for k in range(len(starts)):
        (ax, ay), (bx, by) = starts[k], ends[k]
        dx, dy = bx - ax, by - ay
        square = max(dx * dx + dy * dy, 1e-300)
        for n in range(len(points)):
            x, y = points[n, 0] - ax, points[n, 1] - ay
            t = min(max((x * dx + y * dy) / square, 0.0), 1.0)
            best[n] = min(best[n], np.hypot(x - t * dx, y - t * dy))
    return best
