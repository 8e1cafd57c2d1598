"""Silhouettes by brute force: the oracle of the search tree, and its rival.

Both test every edge and decide the facing of every face exactly (`geometry.predicates`), so they return the same set of
directed edges: (v0, v1) of the edge table where the left face is front-facing and the right face is not, (v1, v0) where it is
the other way round. Based on: Silhouette Clipping, section 5.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from geometry.predicates import is_front_facing

PLANE_ERROR = 2.0**-20
"""Bound on the error of n . p + d w in float32, relative to |p|_1 + |d| w: 16 u, of which six roundings use at most 8."""
FARTHEST_FLOAT = 1e30
"""Eyes and planes beyond are decided by the predicate alone: float32 sums of them could overflow."""
_TINY = np.float32(1e-30)  # sums smaller than this may have lost bits to underflow
_RELIABLE = 1e-8  # relative error of a unit normal that counts as exact beside float32
_DOUBTS = np.uint64(0x0101010101010101)  # a doubtful byte is 1; back is 0, front is 2
_LANES = 8  # bytes in a word


class FacePlanes(NamedTuple):
    """Unit face planes in float32, one array a coordinate so that the facing loop is vectorised.

    x, y, z, d: (f,) f4; a point is outside when x px + y py + z pz + d w > 0. All zero, hence always doubtful, where the
    normal is not known well enough. farthest: largest |d|.
    """

    x: np.ndarray
    y: np.ndarray
    z: np.ndarray
    d: np.ndarray
    farthest: float


def face_planes(positions, faces):
    """FacePlanes of positions (v, 3) f4 and faces (f, 3) i4."""
    x, y, z, d = (np.empty(len(faces), np.float32) for _ in range(4))
    farthest = _fill_planes(np.ascontiguousarray(positions, np.float64), faces, x, y, z, d)
    return FacePlanes(x, y, z, d, float(farthest))


@njit(cache=True, nogil=True)
def _fill_planes(p, faces, x, y, z, d):
    """Planes into (f,) f4 arrays; the largest |d|."""
    farthest = np.float32(0.0)
    for f in range(faces.shape[0]):
        a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
        ux, uy, uz = p[b, 0] - p[a, 0], p[b, 1] - p[a, 1], p[b, 2] - p[a, 2]
        vx, vy, vz = p[c, 0] - p[a, 0], p[c, 1] - p[a, 1], p[c, 2] - p[a, 2]
        nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
        length = math.sqrt(nx * nx + ny * ny + nz * nz)
        permanent = math.sqrt(ux * ux + uy * uy + uz * uz) * math.sqrt(vx * vx + vy * vy + vz * vz)
        x[f] = y[f] = z[f] = d[f] = 0.0
        if not (length > 1e-140 and permanent * 1.8e-15 <= _RELIABLE * length):
            continue
        nx, ny, nz = nx / length, ny / length, nz / length
        offset = -(nx * p[a, 0] + ny * p[a, 1] + nz * p[a, 2])
        if abs(offset) < FARTHEST_FLOAT:
            x[f], y[f], z[f], d[f] = nx, ny, nz, offset
            farthest = max(farthest, abs(d[f]))
    return farthest


@njit(cache=True, nogil=True)
def silhouette_scalar(positions, faces, edge_vertices, edge_faces, eye):
    """(s, 2) i4 directed silhouette edges, edge by edge, nothing precomputed and nothing but the predicate: the oracle.

    positions (v, 3) f4, faces (f, 3) i4, edge_vertices and edge_faces (e, 2) i4 (`geometry.topology.EdgeTable`), eye (4,) f8.
    """
    out = np.empty((edge_vertices.shape[0], 2), np.int32)
    count = 0
    for e in range(edge_vertices.shape[0]):
        left = is_front_facing(positions, faces, edge_faces[e, 0], eye)
        right = is_front_facing(positions, faces, edge_faces[e, 1], eye)
        if left != right:
            start = 0 if left else 1
            out[count, 0], out[count, 1] = edge_vertices[e, start], edge_vertices[e, 1 - start]
            count += 1
    return out[:count].copy()


@njit(cache=True, inline="always")
def _plane_side(planes, f, px, py, pz, w, bound):
    """2 front, 0 back, 1 doubtful, as `_facing`."""
    s = planes.x[f] * px + planes.y[f] * py + planes.z[f] * pz + planes.d[f] * w
    return 2 if s > bound else (0 if s < -bound else 1)


@njit(cache=True, nogil=True)
def silhouette_edgewise(planes, positions, faces, edge_vertices, edge_faces, eye):
    """The same set, edge by edge as the paper's brute force: both stored planes of each edge tested there and then."""
    far = abs(eye[0]) + abs(eye[1]) + abs(eye[2])
    if not far < FARTHEST_FLOAT:
        return silhouette_scalar(positions, faces, edge_vertices, edge_faces, eye)
    bound = np.float32(PLANE_ERROR * (far + planes.farthest * eye[3])) + _TINY
    px, py, pz, w = np.float32(eye[0]), np.float32(eye[1]), np.float32(eye[2]), np.float32(eye[3])
    out = np.empty((edge_vertices.shape[0], 2), np.int32)
    count = 0
    for e in range(edge_vertices.shape[0]):
        f, g = np.uint32(edge_faces[e, 0]), np.uint32(edge_faces[e, 1])
        left, right = _plane_side(planes, f, px, py, pz, w, bound), _plane_side(planes, g, px, py, pz, w, bound)
        if left == 1:
            left = 2 if is_front_facing(positions, faces, f, eye) else 0
        if right == 1:
            right = 2 if is_front_facing(positions, faces, g, eye) else 0
        if left != right:
            start = 0 if left == 2 else 1
            out[count, 0], out[count, 1] = edge_vertices[e, start], edge_vertices[e, 1 - start]
            count += 1
    return out[:count].copy()


@njit(cache=True, nogil=True)
def _facing(x, y, z, d, px, py, pz, w, bound, side):
    """side: 2 front, 0 back, 1 doubtful. Nothing but this in the loop, so that it is vectorised."""
    for f in range(x.shape[0]):
        s = x[f] * px + y[f] * py + z[f] * pz + d[f] * w
        side[f] = np.uint8(s > bound) + np.uint8(s >= -bound)


@njit(cache=True, nogil=True)
def _settle(positions, faces, eye, side):
    """Decide the doubtful faces exactly; side (padded to words) then holds 0 and 2 only."""
    words = side.view(np.uint64)
    for i in range(words.shape[0]):
        if words[i] & _DOUBTS:
            for f in range(i * _LANES, min((i + 1) * _LANES, faces.shape[0])):
                if side[f] == 1:
                    side[f] = 2 if is_front_facing(positions, faces, f, eye) else 0


@njit(cache=True, nogil=True)
def face_sides(planes, positions, faces, eye):
    """u1 bytes, 2 for each front-facing face and 0 for each other, decided exactly; zeros after the last fill the last word.

    planes: `face_planes(positions, faces)`, eye (4,) f8.
    """
    n = faces.shape[0]
    side = np.empty((n + _LANES - 1) // _LANES * _LANES, np.uint8)
    side[n:] = 0
    far = abs(eye[0]) + abs(eye[1]) + abs(eye[2])
    if not far < FARTHEST_FLOAT:
        side[:n] = 1
    else:
        bound = np.float32(PLANE_ERROR * (far + planes.farthest * eye[3])) + _TINY
        px, py, pz, w = np.float32(eye[0]), np.float32(eye[1]), np.float32(eye[2]), np.float32(eye[3])
        _facing(planes.x, planes.y, planes.z, planes.d, px, py, pz, w, bound, side)
    _settle(positions, faces, eye, side)
    return side


@njit(cache=True, nogil=True)
def _differing(edge_faces, side, differs):
    """differs (e,) u1: 2 where the two faces of an edge differ, else 0."""
    for e in range(edge_faces.shape[0]):
        # unsigned: numba need not ask whether an index counts from the end
        differs[e] = side[np.uint32(edge_faces[e, 0])] ^ side[np.uint32(edge_faces[e, 1])]


@njit(cache=True, nogil=True)
def _collect(differs, chosen):
    """Numbers of the non-zero bytes into chosen, without a branch an edge; returns their number."""
    words = differs.view(np.uint64)
    count = 0
    for i in range(words.shape[0]):
        if words[i]:
            for j in range(_LANES):
                chosen[count] = i * _LANES + j
                count += differs[i * _LANES + j] >> 1
    return count


@njit(cache=True, nogil=True)
def silhouette_simd(planes, positions, faces, edge_vertices, edge_faces, eye):
    """The same set by the fastest brute force we know: SIMD bits for all faces first, then a scan of the edges.

    planes: `face_planes(positions, faces)`. The other arguments and the result are those of `silhouette_scalar`.
    """
    far = abs(eye[0]) + abs(eye[1]) + abs(eye[2])
    if not far < FARTHEST_FLOAT:
        return silhouette_scalar(positions, faces, edge_vertices, edge_faces, eye)
    e = edge_vertices.shape[0]
    side = face_sides(planes, positions, faces, eye)
    differs = np.empty((e + _LANES - 1) // _LANES * _LANES, np.uint8)
    differs[e:] = 0
    _differing(edge_faces, side, differs)
    chosen = np.empty(e + _LANES, np.int32)
    count = _collect(differs, chosen)
    out = np.empty((count, 2), np.int32)
    for k in range(count):
        i = chosen[k]
        start = 1 - (side[edge_faces[i, 0]] >> 1)
        out[k, 0], out[k, 1] = edge_vertices[i, start], edge_vertices[i, 1 - start]
    return out
