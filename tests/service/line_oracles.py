"""Brute force about lines: which points are hidden, by rays and by a depth buffer; where faces cross; distances of polylines."""

from __future__ import annotations

from itertools import combinations

import numpy as np

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
    p = positions.astype(np.float64)
    a, u, v = p[faces[:, 0]], p[faces[:, 1]] - p[faces[:, 0]], p[faces[:, 2]] - p[faces[:, 0]]
    hidden, sure = np.zeros(len(points), bool), np.ones(len(points), bool)
    for n, (d, far) in enumerate(zip(*_rays(view, points), strict=True)):
        across = np.cross(d, v)
        det = np.einsum("fi,fi->f", u, across)
        edge_on = np.abs(det) <= EDGE_ON * np.linalg.norm(u, axis=1) * np.linalg.norm(v, axis=1) * np.linalg.norm(d)
        det = np.where(edge_on, np.nan, det)
        with np.errstate(divide="ignore", invalid="ignore"):
            s = np.einsum("fi,fi->f", points[n] - a, across) / det
            turned = np.cross(points[n] - a, u)
            t, along = turned @ d / det, np.einsum("fi,fi->f", v, turned) / det
            inner = np.minimum(np.minimum(s, t), 1.0 - s - t)
        distance = along * np.linalg.norm(d)
        between = (distance > NEXT) & (along < far)
        beside = (distance > ON) & (distance <= NEXT) & (inner > -MARGIN)
        hidden[n] = (between & (inner > MARGIN)).any()
        sure[n] = hidden[n] or not ((between & (inner > -MARGIN)) | beside).any()
    return hidden, sure


def depth_buffer(view, positions, faces, scale):
    """(h scale, w scale) f8: depth along the axis of what is nearest at each sample, inf where nothing is."""
    matrix = view.pixels[[0, 1, 3]]
    h = positions.astype(np.float64) @ matrix[:, :3].T + matrix[:, 3]
    depth = -(positions.astype(np.float64) @ view.view[2, :3] + view.view[2, 3])
    xy, near = h[:, :2] / h[:, 2:] * scale, depth if view.orthographic else 1.0 / depth
    buffer = np.full((view.height * scale, view.width * scale), np.inf)
    for i, j, k in faces.tolist():
        (ax, ay), (bx, by), (cx, cy) = xy[i], xy[j], xy[k]
        area = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
        x0, x1 = max(int(min(ax, bx, cx)), 0), min(int(max(ax, bx, cx)) + 1, buffer.shape[1])
        y0, y1 = max(int(min(ay, by, cy)), 0), min(int(max(ay, by, cy)) + 1, buffer.shape[0])
        if area == 0.0 or x0 >= x1 or y0 >= y1:
            continue
        y, x = np.mgrid[y0:y1, x0:x1] + 0.5
        s = ((cx - x) * (ay - y) - (cy - y) * (ax - x)) / area
        t = ((ax - x) * (by - y) - (ay - y) * (bx - x)) / area
        z = near[i] + s * (near[j] - near[i]) + t * (near[k] - near[i])
        z = np.where((s >= 0) & (t >= 0) & (s + t <= 1), z if view.orthographic else 1.0 / z, np.inf)
        buffer[y0:y1, x0:x1] = np.minimum(buffer[y0:y1, x0:x1], z)
    return buffer


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
    best = np.full(len(points), np.inf)
    for a, b in zip(starts, ends, strict=True):
        d = b - a
        t = np.clip((points - a) @ d / max(d @ d, 1e-300), 0.0, 1.0)
        best = np.minimum(best, np.linalg.norm(points - a - t[:, None] * d, axis=1))
    return best
