"""Where lines belong: exact silhouette edges, and rays to their points for what hides them. No GL, no depth buffer."""

from __future__ import annotations

import numpy as np
from numba import njit

from geometry.silhouettes import silhouette_scalar
from geometry.topology import build_edges
from service.camera import project, to_pixels

STEP_PX = 0.5
NEAR_PART = 1e-9
"""A hit so near to the point is the point itself."""


def silhouette_points(asset, view):
    """(pixels (n, 2), outward normals (n, 2), visible (n,) bool) of points along the mesh's silhouette edges, STEP_PX apart."""
    positions = asset.positions.astype(np.float64)
    table = build_edges(asset.faces)
    edges = silhouette_scalar(asset.positions, asset.faces, table.vertices, table.faces, view.eye)
    pixels, normals, points, owners = [], [], [], []
    for a, b in edges:
        ends = to_pixels(view, project(view, positions[[a, b]]))
        if not np.isfinite(ends).all():
            continue
        along = ends[1] - ends[0]
        length = np.linalg.norm(along)
        if length < 1e-9:
            continue
        t = (np.arange(max(1, int(length / STEP_PX))) + 0.5) / max(1, int(length / STEP_PX))
        pixels.append(ends[0] + t[:, None] * along)
        # the front face is on the left: up in the picture is down in its rows
        normals.append(np.tile(np.array([-along[1], along[0]]) / length, (len(t), 1)))
        w = project(view, positions[[a, b]])[:, 3]
        s = t * w[0] / (t * w[0] + (1.0 - t) * w[1])
        points.append(positions[a] + s[:, None] * (positions[b] - positions[a]))
        owners += [(a, b)] * len(t)
    return np.concatenate(pixels), np.concatenate(normals), visible(positions, asset.faces, view.eye, np.concatenate(points), owners)


def visible(positions, faces, eye, points, owners):
    """(n,) bool: no face but those at the ends of its edge is between a point and the eye (4,). Moeller and Trumbore's test."""
    return _visible(positions, faces, eye, points, np.asarray(owners))


@njit(cache=True)
def _visible(positions, faces, eye, points, owners):
    seen = np.ones(len(points), np.bool_)
    for n in range(len(points)):
        a, b = owners[n]
        x, y, z = points[n]
        dx, dy, dz = eye[0] - eye[3] * x, eye[1] - eye[3] * y, eye[2] - eye[3] * z
        for f in range(len(faces)):
            i, j, k = faces[f]
            if a in (i, j, k) or b in (i, j, k):
                continue
            (ax, ay, az), (bx, by, bz), (cx, cy, cz) = positions[i], positions[j], positions[k]
            ux, uy, uz, vx, vy, vz = bx - ax, by - ay, bz - az, cx - ax, cy - ay, cz - az
            px, py, pz = dy * vz - dz * vy, dz * vx - dx * vz, dx * vy - dy * vx
            det = ux * px + uy * py + uz * pz
            if det == 0.0:
                continue
            sx, sy, sz = x - ax, y - ay, z - az
            qx, qy, qz = sy * uz - sz * uy, sz * ux - sx * uz, sx * uy - sy * ux
            s, t = (sx * px + sy * py + sz * pz) / det, (qx * dx + qy * dy + qz * dz) / det
            way = (vx * qx + vy * qy + vz * qz) / det
            if s >= 0.0 and t >= 0.0 and s + t <= 1.0 and way > NEAR_PART and (way < 1.0 or eye[3] == 0.0):
                seen[n] = False
                break
    return seen


def within(view, pixels):
    """(n,) bool: points that are in the picture, two pixels from its border."""
    return ((pixels > 2.0) & (pixels < np.array([view.width, view.height]) - 2.0)).all(axis=1)


def sampled(image, pixels):
    """(n,) f8: a picture of (h, w) numbers at points (n, 2), between its pixels' centres linearly."""
    x, y = np.clip(pixels[:, 0] - 0.5, 0, image.shape[1] - 1.001), np.clip(pixels[:, 1] - 0.5, 0, image.shape[0] - 1.001)
    i, j = x.astype(int), y.astype(int)
    fx, fy = x - i, y - j
    top = image[j, i] * (1 - fx) + image[j, i + 1] * fx
    return top * (1 - fy) + (image[j + 1, i] * (1 - fx) + image[j + 1, i + 1] * fx) * fy
