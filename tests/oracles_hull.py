"""Does a hull enclose points? By winding numbers from solid angles and distances, independent of how hulls are built."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

TOUCHING = 1e-6
"""Normalised units: nearer to the hull's surface than this is on it (float32 positions, float64 tests)."""

NEIGHBOURHOOD = 1e-5
"""Normalised units within which a surface point's two sides are looked at."""


@njit(cache=True)
def winding_number(positions, faces, x, y, z):
    """Winding number of a closed mesh (positions (v, 3) f8) about a point: an integer off the surface, a fraction on it."""
    total = 0.0
    for f in range(faces.shape[0]):
        i, j, k = faces[f, 0], faces[f, 1], faces[f, 2]
        ax, ay, az = positions[i, 0] - x, positions[i, 1] - y, positions[i, 2] - z
        bx, by, bz = positions[j, 0] - x, positions[j, 1] - y, positions[j, 2] - z
        cx, cy, cz = positions[k, 0] - x, positions[k, 1] - y, positions[k, 2] - z
        a, b, c = math.sqrt(ax * ax + ay * ay + az * az), math.sqrt(bx * bx + by * by + bz * bz), math.sqrt(cx * cx + cy * cy + cz * cz)
        det = ax * (by * cz - bz * cy) + ay * (bz * cx - bx * cz) + az * (bx * cy - by * cx)
        ab, bc, ca = ax * bx + ay * by + az * bz, bx * cx + by * cy + bz * cz, cx * ax + cy * ay + cz * az
        total += math.atan2(det, a * b * c + ab * c + bc * a + ca * b)
    return total / (2.0 * math.pi)


@njit(cache=True)
def _segment_square(px, py, pz, ux, uy, uz):
    """Squared distance of the point p to the segment from the origin to u."""
    length = ux * ux + uy * uy + uz * uz
    t = 0.0 if length == 0.0 else min(1.0, max(0.0, (px * ux + py * uy + pz * uz) / length))
    return (px - t * ux) ** 2 + (py - t * uy) ** 2 + (pz - t * uz) ** 2


@njit(cache=True)
def distance(positions, faces, x, y, z):
    """Distance of a point to the surface."""
    best = np.inf
    for f in range(faces.shape[0]):
        a, b, c = positions[faces[f, 0]], positions[faces[f, 1]], positions[faces[f, 2]]
        ux, uy, uz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
        vx, vy, vz = c[0] - a[0], c[1] - a[1], c[2] - a[2]
        px, py, pz = x - a[0], y - a[1], z - a[2]
        best = min(best, _segment_square(px, py, pz, ux, uy, uz), _segment_square(px, py, pz, vx, vy, vz))
        best = min(best, _segment_square(x - b[0], y - b[1], z - b[2], vx - ux, vy - uy, vz - uz))
        nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
        square = nx * nx + ny * ny + nz * nz
        if square == 0.0:
            continue
        # barycentric coordinates of the foot on the plane
        s = ((py * vz - pz * vy) * nx + (pz * vx - px * vz) * ny + (px * vy - py * vx) * nz) / square
        t = ((uy * pz - uz * py) * nx + (uz * px - ux * pz) * ny + (ux * py - uy * px) * nz) / square
        if s >= 0.0 and t >= 0.0 and s + t <= 1.0:
            best = min(best, (px * nx + py * ny + pz * nz) ** 2 / square)
    return math.sqrt(best)


@njit(cache=True)
def _outside(positions, faces, points):
    found = np.zeros(points.shape[0], np.bool_)
    for n in range(points.shape[0]):
        x, y, z = points[n, 0], points[n, 1], points[n, 2]
        if winding_number(positions, faces, x, y, z) < 0.99:
            found[n] = distance(positions, faces, x, y, z) > TOUCHING
    return found


@njit(cache=True)
def _windings(positions, faces, points):
    found = np.empty(points.shape[0])
    for n in range(points.shape[0]):
        found[n] = winding_number(positions, faces, points[n, 0], points[n, 1], points[n, 2])
    return found


@njit(cache=True)
def _distances(positions, faces, points):
    found = np.empty(points.shape[0])
    for n in range(points.shape[0]):
        found[n] = distance(positions, faces, points[n, 0], points[n, 1], points[n, 2])
    return found


def distances(positions: np.ndarray, faces: np.ndarray, points: np.ndarray) -> np.ndarray:
    """(n,) f8 distance of each of the (n, 3) points to the surface."""
    return _distances(np.asarray(positions, np.float64), np.asarray(faces, np.int64), np.asarray(points, np.float64))


def winding_numbers(positions: np.ndarray, faces: np.ndarray, points: np.ndarray) -> np.ndarray:
    """(n,) f8 winding number of a closed mesh about each of the (n, 3) points."""
    return _windings(np.asarray(positions, np.float64), np.asarray(faces, np.int64), np.asarray(points, np.float64))


def points_outside(hull_positions: np.ndarray, hull_faces: np.ndarray, points: np.ndarray) -> np.ndarray:
    """(n,) bool: which of the (n, 3) points are neither inside the hull (winding number at least 1) nor on its surface."""
    return _outside(np.asarray(hull_positions, np.float64), np.asarray(hull_faces, np.int64), np.asarray(points, np.float64))


def uncovered(
    positions: np.ndarray, faces: np.ndarray, hull_positions: np.ndarray, hull_faces: np.ndarray, points: np.ndarray
) -> np.ndarray:
    """(n,) bool: which of the (n, 3) points of the original's surface bound its interior and are outside the hull.

    Interior is where the winding number is positive. A surface that crosses itself is turned inside out in places, with no
    interior on either side: there nothing has to be enclosed. Looked for in a ball of `NEIGHBOURHOOD` about the point.
    """
    found = points_outside(hull_positions, hull_faces, points)
    rng = np.random.default_rng(1)
    for n in np.flatnonzero(found):
        around = points[n] + rng.normal(size=(64, 3)) * NEIGHBOURHOOD
        found[n] = winding_numbers(positions, faces, around).max() > 0.5
    return found


def surface_points(positions: np.ndarray, faces: np.ndarray, count: int, seed: int = 0) -> np.ndarray:
    """(count, 3) f8 random points of random faces, small faces as often as large ones."""
    rng = np.random.default_rng(seed)
    corners = np.asarray(positions, np.float64)[faces[rng.integers(0, len(faces), count)]]
    weight = rng.dirichlet((1.0, 1.0, 1.0), count)
    return np.einsum("nk,nkx->nx", weight, corners)
