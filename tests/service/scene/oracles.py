"""What a ray through a point of the picture meets, found by testing every face of every object."""

from __future__ import annotations

import numpy as np
from numba import njit

from schemas.render import Camera
from schemas.scene import matrix_of
from service.camera import resolve_camera
from service.scene.place import place, sphere_around


def rays(request, assets, columns, rows):
    """(origins (r, 3), directions (r, 3)) f8 in scene units, through points of the picture in pixels; the eye is at depth 0."""
    camera = request.camera
    if isinstance(camera, Camera):
        eye, target, up = (np.array(v, np.float64) for v in (camera.eye, camera.target, camera.up))
        fov = camera.fov_y_deg
        back = (eye - target) / np.linalg.norm(eye - target)
        right = np.cross(up, back)
        right /= np.linalg.norm(right)
        axes = np.stack([right, np.cross(back, right), back])
    else:  # the orbit's own mathematics are tested elsewhere
        around = sphere_around([place(a, matrix_of(o.transform), "") for a, o in zip(assets, request.objects, strict=True)])
        view = resolve_camera(camera, around, request.width, request.height)
        eye, axes, fov = around.to_model(view.eye[:3]), view.view[:3, :3], camera.orbit.fov_y_deg
    u = (columns / request.width * 2 - 1) * request.width / request.height
    v = 1 - rows / request.height * 2
    if isinstance(camera, Camera) and camera.projection == "orthographic":
        half = camera.height / 2
        far = 1e3
        return eye + (u * half)[:, None] * axes[0] + (v * half)[:, None] * axes[1] + far * axes[2], np.tile(-axes[2], (len(u), 1))
    tangent = np.tan(np.radians(fov) / 2)
    return np.tile(eye, (len(u), 1)), (u * tangent)[:, None] * axes[0] + (v * tangent)[:, None] * axes[1] - axes[2]


@njit(cache=True, error_model="numpy")
def _meetings(origins, directions, corners):
    """(r, 2): where each ray first and last meets faces with corners (f, 3, 3). Moeller and Trumbore's test, face by face."""
    found = np.empty((len(origins), 2))
    for r in range(len(origins)):
        (ox, oy, oz), (dx, dy, dz) = origins[r], directions[r]
        first, last = np.inf, -np.inf
        for f in range(len(corners)):
            (ax, ay, az), (bx, by, bz), (cx, cy, cz) = corners[f, 0], corners[f, 1], corners[f, 2]
            bx, by, bz, cx, cy, cz = bx - ax, by - ay, bz - az, cx - ax, cy - ay, cz - az
            px, py, pz = dy * cz - dz * cy, dz * cx - dx * cz, dx * cy - dy * cx
            det = px * bx + py * by + pz * bz  # 0: along the ray, which others around the face stand for; nothing below holds then
            sx, sy, sz = ox - ax, oy - ay, oz - az
            u = (sx * px + sy * py + sz * pz) / det
            qx, qy, qz = sy * bz - sz * by, sz * bx - sx * bz, sx * by - sy * bx
            v = (dx * qx + dy * qy + dz * qz) / det
            t = (qx * cx + qy * cy + qz * cz) / det
            if u >= 0.0 and v >= 0.0 and u + v <= 1.0 and t > 0.0:
                first, last = min(first, t), max(last, t)
        found[r] = first, last
    return found


def depths(request, assets, origins, directions):
    """(r, objects, 2) f8: where each ray first and last meets each object's original; infinite and minus infinite where it does not."""
    found = np.empty((len(origins), len(assets), 2))
    for k, (asset, item) in enumerate(zip(assets, request.objects, strict=True)):
        matrix = matrix_of(item.transform)
        vertices = asset.frame.to_model(asset.positions) @ matrix[:3, :3].T + matrix[:3, 3]
        found[:, k] = _meetings(origins, directions, vertices[asset.faces])
    return found


def nearest_objects(request, assets, finer=2):
    """(h, w) int: the object seen all over each pixel, -1 for none, -2 where (finer + 1)^2 points of the pixel do not agree."""
    width, height = request.width, request.height
    columns, rows = np.meshgrid(np.arange(finer * width + 1) / finer, np.arange(finer * height + 1) / finer)
    first = depths(request, assets, *rays(request, assets, columns.ravel(), rows.ravel()))[:, :, 0]
    seen = np.where(np.isfinite(first.min(axis=1)), first.argmin(axis=1), -1).reshape(columns.shape)
    points = np.stack(
        [seen[y : y + finer * height : finer, x : x + finer * width : finer] for y in range(finer + 1) for x in range(finer + 1)]
    )
    return np.where((points == points[0]).all(axis=0), points[0], -2)
