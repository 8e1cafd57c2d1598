"""Texels of the triangle tiles: the rays they shoot, what they find, and their padding.

Where the texels of a tile lie: `geometry.tile_layout`.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from geometry.tile_layout import texel_at

LEAST_FACING = 0.1  # a ray makes at most 84 degrees with the normal of the face that it leaves


@njit(cache=True)
def texels_per_tile(side):
    """Lattice points of a tile, padding apart."""
    return (side + 1) * (side + 2) // 2


@njit(cache=True)
def _ray_direction(n, face_normal):
    """Make n (3,) unit in place, first turned towards the face normal until it faces it by LEAST_FACING at least."""
    length = math.sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2])
    if length > 0.0:
        n /= length
    facing = n[0] * face_normal[0] + n[1] * face_normal[1] + n[2] * face_normal[2]
    if facing < LEAST_FACING:
        # the sine of the wanted angle along the face, its cosine along the normal
        tangent = n - facing * face_normal
        length = math.sqrt(tangent[0] * tangent[0] + tangent[1] * tangent[1] + tangent[2] * tangent[2])
        sine = math.sqrt(1.0 - LEAST_FACING * LEAST_FACING) / length if length > 1e-9 else 0.0
        n[:] = LEAST_FACING * face_normal + sine * tangent
        n /= math.sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2])


@njit(cache=True)
def tile_rays(positions, faces, normals, face_normals, turns, side, first, last):
    """(origins, directions) (n, 3) f8 of the texels of faces [first, last), tile by tile, j outer and i inner.

    positions, normals (hv, 3) f4; face_normals (hf, 3) f8 unit; turns (hf,) i4: the corner at the right angle.
    Origins lie on the faces; directions are unit and point inwards.
    """
    count = texels_per_tile(side)
    origins = np.empty(((last - first) * count, 3))
    directions = np.empty_like(origins)
    normal = np.empty(3)
    n = 0
    for f in range(first, last):
        a, b, c = faces[f, turns[f]], faces[f, (turns[f] + 1) % 3], faces[f, (turns[f] + 2) % 3]
        for j in range(side + 1):
            for i in range(side + 1 - j):
                s, t = i / side, j / side
                r = (side - i - j) / side
                for k in range(3):
                    origins[n, k] = r * positions[a, k] + s * positions[b, k] + t * positions[c, k]
                    normal[k] = r * normals[a, k] + s * normals[b, k] + t * normals[c, k]
                _ray_direction(normal, face_normals[f])
                for k in range(3):
                    directions[n, k] = -normal[k]
                n += 1
    return origins, directions


@njit(cache=True)
def ray_hits(positions, faces, origins, directions, found, weights, distance):
    """Where rays meet the planes of the faces that were found for them: weights (n, 3) f8, clamped to the face, distance (n,) f8.

    found (n,) i4: a face, or -1: none. Returns (n,) bool: the ray meets the outer side of its face.
    """
    outer = np.zeros(found.shape[0], np.bool_)
    u, v, w = np.empty(3), np.empty(3), np.empty(3)
    for n in range(found.shape[0]):
        f = found[n]
        if f < 0:
            continue
        for k in range(3):
            a = np.float64(positions[faces[f, 0], k])
            u[k], v[k], w[k] = positions[faces[f, 1], k] - a, positions[faces[f, 2], k] - a, origins[n, k] - a
        d = directions[n]
        gx, gy, gz = u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]
        slope = gx * d[0] + gy * d[1] + gz * d[2]
        outer[n] = slope < 0.0
        if slope == 0.0:
            weights[n, :] = 1.0 / 3.0
            distance[n] = 0.0
            continue
        distance[n] = -(gx * w[0] + gy * w[1] + gz * w[2]) / slope
        # q = w x d; the weights are ratios of triple products
        qx, qy, qz = w[1] * d[2] - w[2] * d[1], w[2] * d[0] - w[0] * d[2], w[0] * d[1] - w[1] * d[0]
        s = max(0.0, -(v[0] * qx + v[1] * qy + v[2] * qz) / slope)
        t = max(0.0, (u[0] * qx + u[1] * qy + u[2] * qz) / slope)
        r = max(0.0, 1.0 - s - t)
        total = r + s + t
        weights[n, 0], weights[n, 1], weights[n, 2] = r / total, s / total, t / total
    return outer


@njit(cache=True)
def sampled_normals(positions, faces, normals, rows, found, weights):
    """(n, 3) f8 unit: the original's normals, rows[f] at face f's corners, interpolated; the face's own where they cancel."""
    out = np.empty((found.shape[0], 3))
    for n in range(found.shape[0]):
        f = found[n]
        a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
        for k in range(3):
            out[n, k] = 0.0
            for corner in range(3):
                out[n, k] += weights[n, corner] * normals[rows[f, corner], k]
        length = math.sqrt(out[n, 0] ** 2 + out[n, 1] ** 2 + out[n, 2] ** 2)
        if length < 1e-6:
            for k in range(3):
                i, j = (k + 1) % 3, (k + 2) % 3
                out[n, k] = (np.float64(positions[b, i]) - positions[a, i]) * (np.float64(positions[c, j]) - positions[a, j]) - (
                    np.float64(positions[b, j]) - positions[a, j]
                ) * (np.float64(positions[c, i]) - positions[a, i])
            length = math.sqrt(out[n, 0] ** 2 + out[n, 1] ** 2 + out[n, 2] ** 2)
        if length > 0.0:
            out[n] /= length
    return out


@njit(cache=True)
def with_padding(values, side):
    """(tiles * (texels_per_tile + side), c) f8: each tile's values in the order of `tile_rays`, then its padding by rising i."""
    count = texels_per_tile(side)
    tiles, channels = values.shape[0] // count, values.shape[1]
    out = np.empty((tiles * (count + side), channels))
    for tile in range(tiles):
        base, n = tile * count, tile * (count + side)
        for k in range(channels):
            out[n : n + count, k] = values[base : base + count, k]
        n += count
        for i in range(1, side + 1):
            j = side + 1 - i
            below = base + (j - 1) * (side + 1) - (j - 1) * (j - 2) // 2  # the lattice row of (., j - 1)
            row = below + side + 2 - j
            for k in range(channels):
                out[n, k] = values[below + i, k] + values[row + i - 1, k] - values[below + i - 1, k]
            n += 1
    return out


@njit(cache=True)
def place_texels(values, image, side, columns, first, last):
    """Write u1 values in the order of `with_padding`, of the tiles of faces [first, last), into image (h, w, c)."""
    n = 0
    for f in range(first, last):
        for j in range(side + 1):
            for i in range(side + 1 - j):
                row, column = texel_at(f, i, j, side, columns)
                image[row, column] = values[n]
                n += 1
        for i in range(1, side + 1):
            row, column = texel_at(f, i, side + 1 - i, side, columns)
            image[row, column] = values[n]
            n += 1


@njit(cache=True)
def turned_normals(normal, basis, side, columns, out):
    """Write into out (h, w, 3) u1 the encoded normals (h, w, 3) u1 of every tile, padding included, turned by basis (hf, 3, 3) f8."""
    for f in range(basis.shape[0]):
        for j in range(side + 1):
            for i in range(min(side, side + 1 - j) + 1):
                row, column = texel_at(f, i, j, side, columns)
                for k in range(3):
                    turned = 0.0
                    for axis in range(3):
                        turned += basis[f, k, axis] * (normal[row, column, axis] / 127.5 - 1.0)
                    out[row, column, k] = np.uint8(round(min(1.0, max(-1.0, turned)) * 127.5 + 127.5))
