"""The shrink pass of a hull: vertices move inwards against the original itself, not against an intermediate hull.

Based on: Silhouette Clipping, section 3 (least volume by a linear program); what the program is of departs from it. The volume of
the hull is linear in one vertex w. That a point q of the original stays below the new face (w, a, b) is linear too, so the best
place is found with cutting planes: solve, look for points of the original in what would be swept (`shrink_obstacle`), require
the steepest of each face to stay below it, solve again. Only a place whose sweep is free, decided exactly for the float32
vertex, is taken; from places that never become free some steps are gone back towards the old one.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from geometry.borrowing import borrowing
from geometry.boxes import STACK
from geometry.predicates import orient_sign
from worker.kernels.collapse_mesh import following, preceding
from worker.kernels.collapse_place import HALF_ULP
from worker.kernels.linear_program import BOX_ROWS, INFEASIBLE, solve3
from worker.kernels.shrink_obstacle import MOST_CORNERS, Search, copy_point, copy_points, obstacle
from worker.kernels.verify_enclosure import winding_number

RING_LIMIT = 48
"""Neighbours of a vertex; one with more stays where it is."""
CUTS = 14
"""Times that a place is looked for."""
BACK = (0.5, 0.2)
"""Parts of the way tried when the whole way is not free."""
REACH = 2.0
"""Radii (of the faces around the vertex) that it may move along each axis."""
DEPTH = 0.4
"""Radii that it may go below a face of its fan: deeper, the first places sweep half the original."""
LEAST_GAIN = 1e-6
"""Radii cubed of volume that a move must take away."""
KEEP_HEIGHT = 0.1
"""Of its height over the outer edge that a face keeps."""
FOLD = 0.2
"""Cosine of the turn allowed between a face and its successor."""
FLATTEST = 1e-3
"""Height over longest edge of a new face, unless the old one was as flat."""


class Original(NamedTuple):
    """What the hull encloses. positions (v, 3) f4, faces (f, 3) i4; corners (f, 3, 3) f8; order, boxes: its box hierarchy.

    most: the winding number up to which a place may be taken from the hull: 0, and -1 for a mesh turned inside out.
    """

    positions: np.ndarray
    faces: np.ndarray
    corners: np.ndarray
    order: np.ndarray
    boxes: np.ndarray
    most: int


class Fit(NamedTuple):
    """Scratch for one vertex. ring (RING_LIMIT + 1,) i4. rows, bounds, and copies that the program consumes. place (3,) f8."""

    ring: np.ndarray
    rows: np.ndarray
    bounds: np.ndarray
    used_rows: np.ndarray
    used_bounds: np.ndarray
    work: np.ndarray
    objective: np.ndarray
    place: np.ndarray
    tet: np.ndarray
    clipped: np.ndarray
    worst: np.ndarray
    middles: np.ndarray
    search: Search


def new_fit() -> Fit:
    """Scratch for one thread."""
    n = RING_LIMIT * (2 + CUTS)
    return Fit(
        np.empty(RING_LIMIT + 1, np.int32), np.empty((n, 3)), np.empty(n), np.empty((n, 3)), np.empty(n), np.empty((n + BOX_ROWS, 3)),
        np.empty(3), np.empty(3), np.empty((4, 3)), np.empty((2, MOST_CORNERS, 3)), np.empty(3), np.empty((RING_LIMIT, 3)),
        Search(np.empty(STACK, np.int64), np.empty((4, 5)), np.empty(6)),
    )  # fmt: skip


@borrowing
def _gather_ring(mesh, v, ring):
    """Neighbours of v, its faces being (v, ring[i], ring[i + 1]), the first again at the end; their number, 0 when too many."""
    n, first = 0, mesh.out[v]
    h = first
    while True:
        if n == RING_LIMIT:
            return 0
        ring[n] = mesh.corner[following(h)]
        n += 1
        h = mesh.opposite[preceding(h)]
        if h == first:
            break
    ring[n] = ring[0]
    return n


@borrowing
def _radius(positions, v, ring, n):
    radius = 0.0
    for i in range(n):
        for k in range(3):
            radius = max(radius, abs(positions[ring[i], k] - positions[v, k]))
    return radius


@borrowing
def _cut_row(fit, n, v, a, b, q, scale, margin):
    """Row n: the point q stays below the face from the new vertex to a and b."""
    ax, ay, az = (a[0] - v[0]) * scale, (a[1] - v[1]) * scale, (a[2] - v[2]) * scale
    ux, uy, uz = (b[0] - a[0]) * scale, (b[1] - a[1]) * scale, (b[2] - a[2]) * scale
    wx, wy, wz = (q[0] - a[0]) * scale, (q[1] - a[1]) * scale, (q[2] - a[2]) * scale
    nx, ny, nz = uy * wz - uz * wy, uz * wx - ux * wz, ux * wy - uy * wx
    length = math.sqrt(nx * nx + ny * ny + nz * nz)
    if length == 0.0:
        return n
    nx, ny, nz = nx / length, ny / length, nz / length
    fit.rows[n, 0], fit.rows[n, 1], fit.rows[n, 2] = nx, ny, nz
    fit.bounds[n] = nx * ax + ny * ay + nz * az + margin * (abs(nx) + abs(ny) + abs(nz))
    return n + 1


@borrowing
def _first_rows(fit, positions, v, count, scale):
    """Objective, and rows against depth and folds; returns how many, -1 when a face has no plane."""
    fit.objective[0], fit.objective[1], fit.objective[2] = 0.0, 0.0, 0.0
    n = 0
    for i in range(count):
        a, b = positions[fit.ring[i]], positions[fit.ring[i + 1]]
        ax, ay, az = (a[0] - positions[v, 0]) * scale, (a[1] - positions[v, 1]) * scale, (a[2] - positions[v, 2]) * scale
        bx, by, bz = (b[0] - positions[v, 0]) * scale, (b[1] - positions[v, 1]) * scale, (b[2] - positions[v, 2]) * scale
        nx, ny, nz = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
        fit.objective[0] += nx
        fit.objective[1] += ny
        fit.objective[2] += nz
        length = math.sqrt(nx * nx + ny * ny + nz * nz)
        ex, ey, ez = bx - ax, by - ay, bz - az
        edge = math.sqrt(ex * ex + ey * ey + ez * ez)
        if length <= 1e-12 or edge == 0.0:
            return -1
        nx, ny, nz = nx / length, ny / length, nz / length
        fit.rows[n, 0], fit.rows[n, 1], fit.rows[n, 2], fit.bounds[n] = nx, ny, nz, -DEPTH
        n += 1
        # n x (b - a) points from the edge into the face
        ix, iy, iz = (ny * ez - nz * ey) / edge, (nz * ex - nx * ez) / edge, (nx * ey - ny * ex) / edge
        foot = ix * ax + iy * ay + iz * az
        fit.rows[n, 0], fit.rows[n, 1], fit.rows[n, 2], fit.bounds[n] = ix, iy, iz, (1.0 - KEEP_HEIGHT) * foot
        n += 1
    return n


@borrowing
def _put(fit, v, x, y, z, radius):
    """The local point, rounded to float32, into fit.place."""
    fit.place[0] = np.float64(np.float32(v[0] + x * radius))
    fit.place[1] = np.float64(np.float32(v[1] + y * radius))
    fit.place[2] = np.float64(np.float32(v[2] + z * radius))


@borrowing
def _well_shaped(fit, positions, v, count):
    """Whether no face turns over and none becomes flat that was not."""
    w = fit.place
    for i in range(count):
        a, b = positions[fit.ring[i]], positions[fit.ring[i + 1]]
        ux, uy, uz = a[0] - w[0], a[1] - w[1], a[2] - w[2]
        wx, wy, wz = b[0] - w[0], b[1] - w[1], b[2] - w[2]
        nx, ny, nz = uy * wz - uz * wy, uz * wx - ux * wz, ux * wy - uy * wx
        length = math.sqrt(nx * nx + ny * ny + nz * nz)
        longest = max(ux * ux + uy * uy + uz * uz, wx * wx + wy * wy + wz * wz)
        ux, uy, uz = a[0] - positions[v, 0], a[1] - positions[v, 1], a[2] - positions[v, 2]
        wx, wy, wz = b[0] - positions[v, 0], b[1] - positions[v, 1], b[2] - positions[v, 2]
        ox, oy, oz = uy * wz - uz * wy, uz * wx - ux * wz, ux * wy - uy * wx
        old = math.sqrt(ox * ox + oy * oy + oz * oz)
        was = old / max(ux * ux + uy * uy + uz * uz, wx * wx + wy * wy + wz * wz)
        if length <= min(FLATTEST, was) * longest or nx * ox + ny * oy + nz * oz < FOLD * length * old:
            return False
    return True


@borrowing
def _free(original, fit, positions, v, count, rows, scale, margin):
    """(whether the sweep to fit.place is free, rows): one more row for each face that has a point of the original above it."""
    tet, free, swept = fit.tet, True, 0
    copy_point(positions[v], tet[0])
    copy_point(fit.place, tet[3])
    for i in range(count):
        copy_point(positions[fit.ring[i]], tet[1])
        copy_point(positions[fit.ring[i + 1]], tet[2])
        if orient_sign(tet[0], tet[1], tet[2], tet[3, 0], tet[3, 1], tet[3, 2], 1.0) >= 0:
            continue  # outwards: nothing is taken from the hull
        state = obstacle(original.corners, original.order, original.boxes, tet, fit.clipped, fit.worst, fit.search)
        if state:
            free = False
        if state == 2 and rows < fit.rows.shape[0]:
            rows = _cut_row(fit, rows, tet[0], tet[1], tet[2], fit.worst, scale, margin)
        for k in range(3):
            fit.middles[swept, k] = 0.25 * (tet[0, k] + tet[1, k] + tet[2, k] + tet[3, k])
        swept += 1
    if free and swept:
        surface = (original.positions, original.faces, original.order, original.boxes)
        for i in range(swept):
            if winding_number(*surface, fit.middles[i], fit.search.stack, fit.search.reach)[0] > original.most:
                return False, rows
    return free, rows


@borrowing
def _taken(fit, v, radius):
    """Volume that the way from v to the rounded place takes from the hull."""
    g, w = fit.objective, fit.place
    return -(g[0] * (w[0] - v[0]) + g[1] * (w[1] - v[1]) + g[2] * (w[2] - v[2])) * radius**2 / 6.0


@borrowing
def best_place(mesh, original, fit, v):
    """Volume that moving vertex v to fit.place takes from the hull, normalised units cubed; 0 when it stays."""
    positions = mesh.positions
    if mesh.locked[v]:
        return 0.0
    count = _gather_ring(mesh, v, fit.ring)
    radius = _radius(positions, v, fit.ring, count)
    if count < 3 or radius == 0.0:
        return 0.0
    scale = 1.0 / radius
    here = positions[v]
    margin = HALF_ULP * (max(abs(here[0]), abs(here[1]), abs(here[2])) * scale + REACH)
    rows = _first_rows(fit, positions, v, count, scale)
    if rows < 0:
        return 0.0
    g = fit.objective
    x, y, z = 0.0, 0.0, 0.0
    for _ in range(CUTS):
        copy_points(fit.rows, rows, fit.used_rows)
        for n in range(rows):
            fit.used_bounds[n] = fit.bounds[n]
        status, x, y, z = solve3(fit.used_rows, fit.used_bounds, rows, g, REACH, fit.work)
        if status == INFEASIBLE or g[0] * x + g[1] * y + g[2] * z > -LEAST_GAIN:
            return 0.0
        _put(fit, here, x, y, z, radius)
        before = rows
        free, rows = _free(original, fit, positions, v, count, rows, scale, margin)
        if free and _well_shaped(fit, positions, v, count):
            return _taken(fit, here, radius)
        if rows == before:
            break
    for part in BACK:
        _put(fit, here, part * x, part * y, part * z, radius)
        free, _ = _free(original, fit, positions, v, count, rows, scale, margin)
        if free and _well_shaped(fit, positions, v, count):
            return _taken(fit, here, radius)
    return 0.0


@borrowing
def shrink(mesh, original, fit, alive, start, end, moved, places, gains):
    """Move the vertices alive[start:end] (i4) that can be moved; returns how many.

    moved (n,) i4, places (n, 3) f4, gains (n,) f8, n at least end - start: which, where to, and the volume that takes away.
    """
    count = 0
    for n in range(start, end):
        v = alive[n]
        gain = best_place(mesh, original, fit, v)
        if gain <= 0.0:
            continue
        for k in range(3):
            mesh.positions[v, k] = fit.place[k]
            places[count, k] = fit.place[k]
        moved[count], gains[count] = v, gain
        count += 1
    return count
