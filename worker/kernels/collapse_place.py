"""Where the vertex of a collapse goes: linear programs over the planes of F(i+1), rounded to float32, checked exactly.

Based on: Silhouette Clipping, section 3. With G the sum of the area vectors of F(i+1), the volume gained by a vertex v is
(G . v - const) / 6, the sum of the tetrahedra (v, f) over f in F(i+1). Each of them is positive when v is outside its plane,
and the difference of the two meshes is exactly their sum as a chain: so the winding number falls nowhere, *whether or not*
F(i) or F(i+1) intersect themselves (the paper's hypothesis in its footnote), and enclosure needs the signs of these
tetrahedra only. They are decided exactly, for the float32 vertex. As G is a positive combination of the plane normals, the
program is never unbounded.

Departures: the planes are moved outwards by what rounding to float32 can take away, so that the rounded optimum satisfies
the true ones; an end of the edge that is already outside everything is preferred where it costs no more than that (flat
regions: no volume is gained at all); folds are kept away by further linear constraints instead of refusing the collapse.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from geometry.borrowing import borrowing
from geometry.predicates import orient_sign
from worker.kernels.collapse_mesh import FAN_LIMIT, following, preceding
from worker.kernels.linear_program import BOX_ROWS, INFEASIBLE, solve3

REACH = 2.0
"""The new vertex stays within this many radii (of the faces around the edge, about its middle) on each axis."""
HALF_ULP = 6e-8
"""Rounding to float32 moves a coordinate by at most this part of it (2^-24, and a little)."""
NO_PLANE = 1e-14  # of the longest edge squared: below it a face has no usable plane; the exact test still sees the face
SAME_PLANE = 1e-12  # radii: a distance to a plane that float64 cannot tell from zero; the exact test decides
FLATTEST = 1e-4  # height over longest edge that a new face must have, unless the faces it replaces were as flat
FLATTEST_EVER = 1e-9
FOLD = 0.2  # cosine of the turn allowed between a face and its successor
KEEP_HEIGHT = 0.05  # of its height over the outer edge that a face keeps when folds are constrained away


class Place(NamedTuple):
    """Scratch of one placement, sized for FAN_LIMIT faces, in local units about the middle of the edge.

    fan: i4 half-edges. area: (n, 3) f8 area vectors (twice the area). normal: (n, 3) f8 unit, zero where there is no plane.
    offset: (n,) f8. rows, bounds, work: what the linear program consumes. objective: (3,) f8 = G. point: (3,) f8 answer.
    local: (5,) f8: middle of the edge x, y, z, radius, constant of the volume.
    """

    fan: np.ndarray
    area: np.ndarray
    normal: np.ndarray
    offset: np.ndarray
    rows: np.ndarray
    bounds: np.ndarray
    work: np.ndarray
    objective: np.ndarray
    point: np.ndarray
    local: np.ndarray


def new_place() -> Place:
    """Scratch for one thread."""
    n = 2 * FAN_LIMIT
    return Place(
        np.empty(FAN_LIMIT, np.int32),
        np.empty((FAN_LIMIT, 3)),
        np.empty((FAN_LIMIT, 3)),
        np.empty(FAN_LIMIT),
        np.empty((n, 3)),
        np.empty(n),
        np.empty((n + BOX_ROWS, 3)),
        np.empty(3),
        np.empty(3),
        np.empty(5),
    )


@borrowing
def measure_fan(mesh, place, count):
    """Local frame, planes, area vectors and objective of the gathered fan; False when all its vertices coincide."""
    positions, corner, fan, local = mesh.positions, mesh.corner, place.fan, place.local
    a, b = corner[fan[0]], corner[following(fan[0])]
    mx = 0.5 * (positions[a, 0] + positions[b, 0])
    my = 0.5 * (positions[a, 1] + positions[b, 1])
    mz = 0.5 * (positions[a, 2] + positions[b, 2])
    radius = 0.0
    for k in range(count):
        p = corner[following(fan[k])]
        radius = max(radius, abs(positions[p, 0] - mx), abs(positions[p, 1] - my), abs(positions[p, 2] - mz))
    if radius == 0.0:
        return False
    gx, gy, gz, constant = 0.0, 0.0, 0.0, 0.0
    scale = 1.0 / radius
    for k in range(count):
        h = fan[k]
        i, j, m = corner[h], corner[following(h)], corner[preceding(h)]
        x, y, z = positions[i, 0], positions[i, 1], positions[i, 2]
        ux, uy, uz = (positions[j, 0] - x) * scale, (positions[j, 1] - y) * scale, (positions[j, 2] - z) * scale
        wx, wy, wz = (positions[m, 0] - x) * scale, (positions[m, 1] - y) * scale, (positions[m, 2] - z) * scale
        nx, ny, nz = uy * wz - uz * wy, uz * wx - ux * wz, ux * wy - uy * wx
        x, y, z = (x - mx) * scale, (y - my) * scale, (z - mz) * scale
        offset = nx * x + ny * y + nz * z
        place.area[k, 0], place.area[k, 1], place.area[k, 2] = nx, ny, nz
        gx, gy, gz, constant = gx + nx, gy + ny, gz + nz, constant + offset
        length = math.sqrt(nx * nx + ny * ny + nz * nz)
        longest = max(ux * ux + uy * uy + uz * uz, wx * wx + wy * wy + wz * wz)
        inverse = 1.0 / length if length > NO_PLANE * longest else 0.0
        place.normal[k, 0], place.normal[k, 1], place.normal[k, 2] = nx * inverse, ny * inverse, nz * inverse
        place.offset[k] = offset * inverse
    place.objective[0], place.objective[1], place.objective[2] = gx, gy, gz
    local[0], local[1], local[2], local[3], local[4] = mx, my, mz, radius, constant
    return True


@borrowing
def _margin(local):
    """Local units that rounding to float32 can move a coordinate, anywhere in the box."""
    return HALF_ULP * (max(abs(local[0]), abs(local[1]), abs(local[2])) / local[3] + REACH)


@borrowing
def _plane_rows(place, count, margin):
    """Rows of the linear program from the planes moved outwards; returns their number."""
    n = 0
    for k in range(count):
        nx, ny, nz = place.normal[k, 0], place.normal[k, 1], place.normal[k, 2]
        if nx == 0.0 and ny == 0.0 and nz == 0.0:
            continue
        place.rows[n, 0], place.rows[n, 1], place.rows[n, 2] = nx, ny, nz
        place.bounds[n] = place.offset[k] + margin * (abs(nx) + abs(ny) + abs(nz)) + 1e-13
        n += 1
    return n


@borrowing
def _fold_rows(mesh, place, count, count_a, n):
    """Rows that keep the new vertex on the inner side of every outer edge, seen along the old face's normal."""
    positions, corner, fan, local = mesh.positions, mesh.corner, place.fan, place.local
    scale = 1.0 / local[3]
    for k in range(1, count):
        if k == count_a - 1:
            continue
        nx, ny, nz = place.normal[k, 0], place.normal[k, 1], place.normal[k, 2]
        if nx == 0.0 and ny == 0.0 and nz == 0.0:
            continue
        h = fan[k]
        i, j, m = corner[h], corner[following(h)], corner[preceding(h)]
        x, y, z = positions[j, 0], positions[j, 1], positions[j, 2]
        ux, uy, uz = (positions[m, 0] - x) * scale, (positions[m, 1] - y) * scale, (positions[m, 2] - z) * scale
        # n x (m - j) points into the face
        ix, iy, iz = ny * uz - nz * uy, nz * ux - nx * uz, nx * uy - ny * ux
        length = math.sqrt(ix * ix + iy * iy + iz * iz)
        if length == 0.0:
            continue
        ix, iy, iz = ix / length, iy / length, iz / length
        height = ((positions[i, 0] - x) * ix + (positions[i, 1] - y) * iy + (positions[i, 2] - z) * iz) * scale
        place.rows[n, 0], place.rows[n, 1], place.rows[n, 2] = ix, iy, iz
        x, y, z = (x - local[0]) * scale, (y - local[1]) * scale, (z - local[2]) * scale
        place.bounds[n] = ix * x + iy * y + iz * z + KEEP_HEIGHT * height
        n += 1
    return n


@borrowing
def _to_float32(place, x, y, z):
    """Local point to the rounded world point in place.point."""
    local, point = place.local, place.point
    point[0] = np.float64(np.float32(local[0] + x * local[3]))
    point[1] = np.float64(np.float32(local[1] + y * local[3]))
    point[2] = np.float64(np.float32(local[2] + z * local[3]))


@borrowing
def gained(place, count):
    """Volume of the tetrahedra from place.point to the faces of the fan, each at least zero; world units."""
    local, point = place.local, place.point
    scale = 1.0 / local[3]
    x, y, z = (point[0] - local[0]) * scale, (point[1] - local[1]) * scale, (point[2] - local[2]) * scale
    total = place.objective[0] * x + place.objective[1] * y + place.objective[2] * z - local[4]
    return max(0.0, total) * local[3] ** 3 / 6.0


@borrowing
def corner_cost(mesh, place, count, count_a, end):
    """Cost of the end a (0) or b (1) of the edge as the new vertex, put into place.point; inf when it is inside a plane.

    Zero exactly when floats cannot tell it from zero: flat regions are collapsed before anything that costs volume.
    """
    positions, corner, fan, local, area = mesh.positions, mesh.corner, place.fan, place.local, place.area
    scale = 1.0 / local[3]
    v = corner[fan[0]] if end == 0 else corner[following(fan[0])]
    x = (positions[v, 0] - local[0]) * scale
    y = (positions[v, 1] - local[1]) * scale
    z = (positions[v, 2] - local[2]) * scale
    # an end lies on its own planes: only the other end's can exclude it
    first, last = (count_a, count) if end == 0 else (1, count_a - 1)
    total = 0.0
    for k in range(first, last):
        nx, ny, nz = place.normal[k, 0], place.normal[k, 1], place.normal[k, 2]
        above = nx * x + ny * y + nz * z - place.offset[k]
        if above < -SAME_PLANE:
            return np.inf
        if above > SAME_PLANE:
            total += (area[k, 0] * nx + area[k, 1] * ny + area[k, 2] * nz) * above
    place.point[0], place.point[1], place.point[2] = positions[v, 0], positions[v, 1], positions[v, 2]
    return total * local[3] ** 3 / 6.0


@borrowing
def best_outside(place, count, widen):
    """Optimum over the planes (moved out by `widen` rounding margins) into place.point; returns its cost, inf when none."""
    n = _plane_rows(place, count, widen * _margin(place.local))
    status, x, y, z = solve3(place.rows, place.bounds, n, place.objective, REACH, place.work)
    if status == INFEASIBLE:
        return np.inf
    _to_float32(place, x, y, z)
    return gained(place, count)


@borrowing
def best_unfolded(mesh, place, count, count_a, widen):
    """As best_outside, with no face turned over."""
    n = _plane_rows(place, count, widen * _margin(place.local))
    n = _fold_rows(mesh, place, count, count_a, n)
    status, x, y, z = solve3(place.rows, place.bounds, n, place.objective, REACH, place.work)
    if status == INFEASIBLE:
        return np.inf
    _to_float32(place, x, y, z)
    return gained(place, count)


@borrowing
def encloses(mesh, place, count):
    """Whether place.point is on or outside the plane of every face of the fan, decided exactly."""
    positions, corner, point = mesh.positions, mesh.corner, place.point
    for k in range(count):
        h = place.fan[k]
        i, j, m = corner[h], corner[following(h)], corner[preceding(h)]
        if orient_sign(positions[i], positions[j], positions[m], point[0], point[1], point[2], 1.0) < 0:
            return False
    return True


@borrowing
def well_shaped(mesh, place, count, count_a):
    """Whether the new faces have area and none turns over against the face that it replaces."""
    positions, corner, fan, point = mesh.positions, mesh.corner, place.fan, place.point
    limit = FLATTEST
    scale = 1.0 / place.local[3]
    flattest = np.inf
    for k in range(count):
        h = fan[k]
        i, j, m = corner[h], corner[following(h)], corner[preceding(h)]
        double_area = math.sqrt(place.area[k, 0] ** 2 + place.area[k, 1] ** 2 + place.area[k, 2] ** 2)
        longest = _longest(positions, i, j, m) * scale * scale
        limit = min(limit, 0.5 * double_area / longest if longest > 0.0 else 0.0)
        if k == 0 or k == count_a - 1:
            continue
        ux, uy, uz = positions[j, 0] - point[0], positions[j, 1] - point[1], positions[j, 2] - point[2]
        wx, wy, wz = positions[m, 0] - point[0], positions[m, 1] - point[1], positions[m, 2] - point[2]
        nx, ny, nz = uy * wz - uz * wy, uz * wx - ux * wz, ux * wy - uy * wx
        length = math.sqrt(nx * nx + ny * ny + nz * nz)
        outer = (positions[j, 0] - positions[m, 0]) ** 2 + (positions[j, 1] - positions[m, 1]) ** 2
        outer += (positions[j, 2] - positions[m, 2]) ** 2
        longest = max(outer, ux * ux + uy * uy + uz * uz, wx * wx + wy * wy + wz * wz)
        flattest = min(flattest, length / longest if longest > 0.0 else 0.0)
        ox, oy, oz = place.normal[k, 0], place.normal[k, 1], place.normal[k, 2]
        if (ox != 0.0 or oy != 0.0 or oz != 0.0) and nx * ox + ny * oy + nz * oz < FOLD * length:
            return False
    return flattest >= max(limit, FLATTEST_EVER)


@borrowing
def _longest(positions, i, j, m):
    """Longest squared edge of a face."""
    longest = 0.0
    for p, q in ((i, j), (j, m), (m, i)):
        x, y, z = positions[p, 0] - positions[q, 0], positions[p, 1] - positions[q, 1], positions[p, 2] - positions[q, 2]
        longest = max(longest, x * x + y * y + z * z)
    return longest
