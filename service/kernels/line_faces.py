"""Which faces of a mesh make lines in a view: those behind the nearest layer that can show beside it.

`layer` (f,) u1 is 1 for faces of the nearest layer and 0 for the others. `touched` (v,) u1 is 1 for vertices that the nearest layer has,
and for those where the surface ends, whose neighbours nobody knows.
"""

from __future__ import annotations

import numpy as np
from numba import njit

FEW, LEAST_PART = 2.0, 0.1
"""Samples, and part of all that it can have, that a face must have not to be suspected of having them by rounding."""
FRONT = 2
"""Byte of a front-facing face (`geometry.silhouettes.face_sides`)."""


@njit(cache=True, nogil=True)
def layer_by_facing(side, layer):
    """The nearest layer of a closed mesh: its front faces."""
    for f in range(layer.shape[0]):
        layer[f] = side[f] >> 1


@njit(cache=True, nogil=True)
def count_samples(numbers, counts):
    """Add to counts (f,) i4 the samples that each face has in numbers (h, w) i4, which hold 1 + the number of a face, or 0."""
    for y in range(numbers.shape[0]):
        for x in range(numbers.shape[1]):
            if numbers[y, x] > 0:
                counts[numbers[y, x] - 1] += 1


@njit(cache=True, nogil=True)
def _samples_of(matrix, grid, positions, faces, f):
    """How many samples a face would have alone: its area in the image; 0 for one that reaches behind the eye."""
    x, y = np.empty(3), np.empty(3)
    for k in range(3):
        p = positions[faces[f, k]]
        w = matrix[3, 0] * p[0] + matrix[3, 1] * p[1] + matrix[3, 2] * p[2] + matrix[3, 3]
        if w <= 0.0:
            return 0.0
        x[k] = (matrix[0, 0] * p[0] + matrix[0, 1] * p[1] + matrix[0, 2] * p[2] + matrix[0, 3]) / w
        y[k] = (matrix[1, 0] * p[0] + matrix[1, 1] * p[1] + matrix[1, 2] * p[2] + matrix[1, 3]) / w
    return 0.5 * abs((x[1] - x[0]) * (y[2] - y[0]) - (x[2] - x[0]) * (y[1] - y[0])) * grid * grid


@njit(cache=True, nogil=True)
def drop_ties(counts, matrix, grid, positions, faces, side, turned, beside):
    """Take the samples from faces that have them only along an edge over which the surface turns away.

    There a face lies behind its neighbour over the edge, by less than depth can tell: of two that are turned differently, the one that
    has fewer samples loses them if they are few. matrix: (4, 4) f8 homogeneous pixels. grid: samples along a pixel. beside: (e, 2) i4.
    """
    for i in range(beside.shape[0]):
        f, g = beside[i, 0], beside[i, 1]
        if counts[f] == 0 or counts[g] == 0 or ((side[f] >> 1) ^ turned[f]) == ((side[g] >> 1) ^ turned[g]):
            continue
        first, second = _samples_of(matrix, grid, positions, faces, f), _samples_of(matrix, grid, positions, faces, g)
        if counts[g] < counts[f] or (counts[g] == counts[f] and second > first):
            f, first = g, second
        if counts[f] < FEW + LEAST_PART * first:
            counts[f] = 0


@njit(cache=True, nogil=True)
def layer_by_sight(counts, small, matrix, grid, positions, side, turned, faces, marks, layer):
    """The nearest layer where facing does not tell: faces that were seen, and small ones that adjoin one of them turned the same way.

    One that could have less than `small` samples may have none; its neighbours then stand for it. turned (f,) u1 (`geometry.features`)
    makes facings of neighbours comparable. marks: (v, 2) u1, room for the two sides of the vertices.
    """
    marks[:] = 0
    for f in range(layer.shape[0]):
        if counts[f] > 0:
            s = (side[f] >> 1) ^ turned[f]
            for k in range(3):
                marks[faces[f, k], s] = 1
    for f in range(layer.shape[0]):
        s = (side[f] >> 1) ^ turned[f]
        layer[f] = counts[f] > 0
        if not layer[f] and (marks[faces[f, 0], s] | marks[faces[f, 1], s] | marks[faces[f, 2], s]):
            layer[f] = _samples_of(matrix, grid, positions, faces, f) < small


@njit(cache=True, nogil=True)
def touch(layer, faces, open_vertices, touched):
    """Fill `touched`."""
    touched[:] = open_vertices
    for f in range(layer.shape[0]):
        if layer[f]:
            touched[faces[f, 0]] = 1
            touched[faces[f, 1]] = 1
            touched[faces[f, 2]] = 1


@njit(cache=True, nogil=True)
def is_grazing(planes, positions, faces, f, eye, most_sine):
    """Whether |V . N| of a face is below most_sine, for V the unit direction from the eye (4,) f8 to its first corner.

    Faces without a normal are: they are seen edge-on from everywhere.
    """
    x, y, z = np.float64(planes.x[f]), np.float64(planes.y[f]), np.float64(planes.z[f])
    if eye[3] == 0.0:
        return abs(x * eye[0] + y * eye[1] + z * eye[2]) < most_sine
    height = x * eye[0] + y * eye[1] + z * eye[2] + planes.d[f]
    a = faces[f, 0]
    dx, dy, dz = positions[a, 0] - eye[0], positions[a, 1] - eye[1], positions[a, 2] - eye[2]
    return height * height < most_sine * most_sine * (dx * dx + dy * dy + dz * dz)


@njit(cache=True, nogil=True)
def near_edge_on(planes, eye, most, near):
    """Fill near (f,) u1: 1 where the eye (4,) f8 is within `most` of the plane of a face. Nothing but this in the loop, so that it is
    vectorised."""
    x, y, z, w, most = np.float32(eye[0]), np.float32(eye[1]), np.float32(eye[2]), np.float32(eye[3]), np.float32(most)
    for f in range(near.shape[0]):
        near[f] = abs(planes.x[f] * x + planes.y[f] * y + planes.z[f] * z + planes.d[f] * w) <= most


@njit(cache=True, nogil=True)
def choose_back(layer, touched, near, planes, positions, faces, eye, most_sine, chosen):
    """Numbers of faces behind the nearest layer that adjoin it or are seen within most_sine of edge-on, into chosen; their count.

    near: `near_edge_on` of most_sine times the distance of the farthest point, beyond which no face is seen edge-on.
    """
    behind = 0
    for f in range(layer.shape[0]):
        chosen[behind] = f
        behind += layer[f] == 0
    count = 0
    for i in range(behind):
        f = chosen[i]
        adjoins = touched[faces[f, 0]] | touched[faces[f, 1]] | touched[faces[f, 2]]
        chosen[count] = f
        count += adjoins or (near[f] and is_grazing(planes, positions, faces, f, eye, most_sine))
    return count


@njit(cache=True, nogil=True)
def choose_grazing(layer, planes, positions, faces, eye, most_sine, chosen):
    """Numbers of faces of the nearest layer that are seen within most_sine of edge-on, into chosen; their count."""
    count = 0
    for f in range(layer.shape[0]):
        if layer[f] and is_grazing(planes, positions, faces, f, eye, most_sine):
            chosen[count] = f
            count += 1
    return count


@njit(cache=True, nogil=True)
def layer_edges(layer, of_layer, side, turned, faces, inner, beside, ends):
    """Edges inner (e, 2) i4, with faces beside (e, 2) i4, over which the surface turns away from the nearest layer; their count.

    A row of ends (n, 4) i4, which is filled: start, end, third corner of the face that is of the layer (of_layer 1) or the one that is
    not (0), the front-facing one where both are, and 1 where that is front-facing, -1 where not.
    """
    count = 0
    for i in range(inner.shape[0]):
        one, other = np.uint32(beside[i, 0]), np.uint32(beside[i, 1])
        if (layer[one] or layer[other]) and (side[one] >> 1) ^ turned[one] != (side[other] >> 1) ^ turned[other]:
            first = layer[one] == of_layer if layer[one] != layer[other] else (side[one] == FRONT) == (of_layer == 1)
            _put_edge(one if first else other, inner[i, 0], inner[i, 1], side, faces, ends[count])
            count += 1
    return count


@njit(cache=True, nogil=True)
def _put_edge(f, a, b, side, faces, row):
    """The edge between a and b as face f has it."""
    for k in range(3):
        c = faces[f, (k + 2) % 3]
        if c != a and c != b:
            row[0], row[1], row[2] = faces[f, k], faces[f, (k + 1) % 3], c
    row[3] = 1 if side[f] == FRONT else -1


@njit(cache=True, nogil=True)
def open_edges(layer, side, faces, ending, ends):
    """Edges where the surface ends, of faces that are not of the nearest layer: ending (n,) i4, 3 face + corner they start at. As above."""
    count = 0
    for i in range(ending.shape[0]):
        f, k = ending[i] // 3, ending[i] % 3
        if not layer[f]:
            ends[count, 0], ends[count, 1], ends[count, 2] = faces[f, k], faces[f, (k + 1) % 3], faces[f, (k + 2) % 3]
            ends[count, 3] = 1 if side[f] == FRONT else -1
            count += 1
    return count


@njit(cache=True, nogil=True)
def all_edges(chosen, side, faces, ends):
    """All edges of chosen faces, as above."""
    for i in range(chosen.shape[0]):
        f = chosen[i]
        for k in range(3):
            row = ends[3 * i + k]
            row[0], row[1], row[2] = faces[f, k], faces[f, (k + 1) % 3], faces[f, (k + 2) % 3]
            row[3] = 1 if side[f] == FRONT else -1
