"""The hull's front faces drawn without a GL: which face each pixel of a rectangle shows, and where its map is read.

This work is based on: Olano and Greer 1997, Triangle Scan Conversion using 2D Homogeneous Coordinates. A face is the region
where three edge functions, linear in the image, are not negative; they need no division by w, so that faces that reach behind
the eye are no special case, and anything linear on the face divided by w is a linear function of the image too.

A pixel is one word: depth in the upper bits, the face's number in the lower ones. The nearest face is the least word, and
along a row the words of a face are an arithmetic progression.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from geometry.borrowing import borrowing

FACE_BITS = 24
FACE_MASK = (1 << FACE_BITS) - 1
EMPTY = np.int64((1 << 62) | FACE_MASK)
"""Word of a pixel where nothing was drawn; farther than anything."""
FARTHEST = 1.5  # depths are held within this of the middle of the depth range
DEPTH_UNIT = float(1 << 37)  # steps of depth from the middle of the depth range to its end
STEEPEST = float(1 << 38)  # depth steps a pixel; a face so steep is less than a pixel wide between near and far
FLAT = 1e-12  # slope of an edge function along the row, relative to that across rows, that counts as none
REACH = 1e-9  # pixels that a face is larger all round, so that rounding leaves no gap between neighbours
SLACK = 8  # words of a row behind the ones that are shown, and pixels drawn at a time
PLANES = 9  # numbers of a face: map u / w, map v / w and 1 / w, each a + b x + c y in that order of x, y, 1


@njit(cache=True, nogil=True, error_model="numpy")
def clip_points(matrix, positions, points):
    """points (v, 4) f8: u, v, z, w of each position (v, 3); u / w and v / w pixels, v down, z / w depth. matrix (4, 4) f8."""
    for i in range(positions.shape[0]):
        x, y, z = np.float64(positions[i, 0]), np.float64(positions[i, 1]), np.float64(positions[i, 2])
        for k in range(4):
            points[i, k] = matrix[k, 0] * x + matrix[k, 1] * y + matrix[k, 2] * z + matrix[k, 3]


@borrowing
def _edge(points, j, k, sense, edges, i):
    """edges[i] = x, y and constant of the edge function of the side j -> k, positive inside a front face."""
    edges[i, 0] = sense * (points[k, 1] * points[j, 3] - points[j, 1] * points[k, 3])
    edges[i, 1] = sense * (points[j, 0] * points[k, 3] - points[k, 0] * points[j, 3])
    edges[i, 2] = sense * (points[k, 0] * points[j, 1] - points[j, 0] * points[k, 1])


@borrowing
def _blend(edges, a, b, c, out, at):
    """out[at:at + 3]: the linear function that is a, b, c at the corners, divided by w and times the determinant."""
    for k in range(3):
        out[at + k] = edges[0, k] * a + edges[1, k] * b + edges[2, k] * c


@borrowing
def _sides(edges, count, sides):
    """Turn edge functions into bounds of a row: sides (8, 2), x >= k + m y for the first four, x <= k + m y for the others.

    Returns (lowest y, highest y) that level edges leave. Of a triangle in front of the eye, at most the first two of each four count.
    """
    low, high, left, right = -np.inf, np.inf, 0, 4
    for i in range(4):
        sides[i, 0], sides[i, 1], sides[4 + i, 0], sides[4 + i, 1] = -np.inf, 0.0, np.inf, 0.0
    for i in range(count):
        a, b, c = edges[i, 0], edges[i, 1], edges[i, 2]
        if abs(a) > FLAT * abs(b):
            row = left if a > 0.0 else right
            left, right = left + (a > 0.0), right + (a <= 0.0)
            sides[row, 0], sides[row, 1] = -c / a, -b / a
        elif b > 0.0:
            low = max(low, -c / b)
        elif b < 0.0:
            high = min(high, -c / b)
        elif c < 0.0:
            high = -np.inf
    return low, high


@njit(cache=True, nogil=True, error_model="numpy")
def place_faces(points, faces, sense, y0, y1, front, seen, rows):
    """Which faces (f, 3) i4 the rows y0..y1 of the image may show: returns n, their numbers in seen[:n] and their rows in rows[:n].

    points (v, 4) f8 of `clip_points`; sense: 1.0, or -1.0 for a view that mirrors. front (f,) bool: which faces turn their front to the
    eye. rows (f, 2) i4: first and last row that the corners span, all of them where a corner is behind the eye.
    """
    edge, n = np.empty((1, 3)), 0
    for f in range(faces.shape[0]):
        a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
        _edge(points, b, c, sense, edge, 0)
        front[f] = edge[0, 0] * points[a, 0] + edge[0, 1] * points[a, 1] + edge[0, 2] * points[a, 3] > 0.0
        if not front[f]:
            continue
        low, high = y0 - 1.0, y1 + 1.0
        if points[a, 3] > 0.0 and points[b, 3] > 0.0 and points[c, 3] > 0.0:
            ya, yb, yc = points[a, 1] / points[a, 3], points[b, 1] / points[b, 3], points[c, 1] / points[c, 3]
            low, high = max(low, min(ya, yb, yc) - REACH), min(high, max(ya, yb, yc) + REACH)
        if not low <= high:
            continue
        first, last = max(np.int64(np.ceil(low - 0.5)), y0), min(np.int64(np.floor(high - 0.5)), y1 - 1)
        if first <= last:
            seen[n], rows[n, 0], rows[n, 1] = f, first, last
            n += 1
    return n


@borrowing
def _fill(sides, depth, face, first, last, x0, y0, x1, words):
    """Draw one face; depth: x, y and constant of z / w. A row of words has SLACK more than it shows."""
    step = np.int64(min(max(depth[0] * DEPTH_UNIT, -STEEPEST), STEEPEST)) << FACE_BITS
    a0, a1, b0, b1 = sides[0, 0], sides[0, 1], sides[1, 0], sides[1, 1]
    c0, c1, d0, d1 = sides[4, 0], sides[4, 1], sides[5, 0], sides[5, 1]
    more = sides[2, 0] > -np.inf or sides[6, 0] < np.inf
    left, right = x0 - 1.0, x1 + 1.0
    for row in range(first, last + 1):
        y = row + 0.5
        low, other = max(a0 + y * a1, left), b0 + y * b1
        high, another = min(c0 + y * c1, right), d0 + y * d1
        low, high = max(low, other), min(high, another)
        if more:
            low = max(low, sides[2, 0] + y * sides[2, 1], sides[3, 0] + y * sides[3, 1])
            high = min(high, sides[6, 0] + y * sides[6, 1], sides[7, 0] + y * sides[7, 1])
        if not low < right or not high > left:
            continue
        begin, end = max(np.int64(np.ceil(low - REACH - 0.5)), x0), min(np.int64(np.floor(high + REACH - 0.5)), x1 - 1) + 1
        z = depth[0] * (begin + 0.5) + depth[1] * y + depth[2]
        word = (np.int64(min(max(z, -FARTHEST), FARTHEST) * DEPTH_UNIT) << FACE_BITS) | face
        line = words[row - y0]
        for block in range(begin, end, SLACK):
            count = end - block
            start = np.uint64(block - x0)
            for i in range(SLACK):
                here = start + np.uint64(i)
                line[here] = min(line[here], word + i * step if i < count else EMPTY)
            word += SLACK * step


@njit(cache=True, nogil=True, error_model="numpy")
def draw_faces(points, faces, uv, sense, seen, rows, x0, y0, x1, y1, words, planes):
    """Draw faces between the near and the far plane into words (y1 - y0, x1 - x0 + SLACK) i8, which is cleared.

    seen (n,) i4, rows (n, 2) i4: of `place_faces`. uv (f, 3, 2) f4 texels. planes (f or more, PLANES) f8: rows of faces that may be seen
    here are filled in.
    """
    edges, sides, depth = np.empty((4, 3)), np.empty((8, 2)), np.empty(3)
    words[...] = EMPTY
    for i in range(seen.shape[0]):
        first, last = max(np.int64(rows[i, 0]), y0), min(np.int64(rows[i, 1]), y1 - 1)
        if first > last:
            continue
        f = seen[i]
        a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
        _edge(points, b, c, sense, edges, 0)
        _edge(points, c, a, sense, edges, 1)
        _edge(points, a, b, sense, edges, 2)
        determinant = edges[0, 0] * points[a, 0] + edges[0, 1] * points[a, 1] + edges[0, 2] * points[a, 3]
        _blend(edges, points[a, 2], points[b, 2], points[c, 2], depth, 0)
        count = 3
        if min(points[a, 2] + points[a, 3], points[b, 2] + points[b, 3], points[c, 2] + points[c, 3]) < 0.0:
            edges[3, 0], edges[3, 1], edges[3, 2] = depth[0], depth[1], depth[2] + determinant
            count = 4
        low, high = _sides(edges, count, sides)
        low, high = max(low - REACH, y0 - 1.0), min(high + REACH, y1 + 1.0)
        if not low <= high:
            continue
        first, last = max(first, np.int64(np.ceil(low - 0.5))), min(last, np.int64(np.floor(high - 0.5)))
        if first > last:
            continue
        _blend(edges, uv[f, 0, 0], uv[f, 1, 0], uv[f, 2, 0], planes[f], 0)
        _blend(edges, uv[f, 0, 1], uv[f, 1, 1], uv[f, 2, 1], planes[f], 3)
        _blend(edges, 1.0, 1.0, 1.0, planes[f], 6)
        for k in range(3):
            depth[k] /= determinant
        _fill(sides, depth, f, first, last, x0, y0, x1, words)
