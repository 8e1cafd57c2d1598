"""Nodes of a smooth contour on curved edges.

An edge is a cubic curve that leaves each end in the tangent plane there, as an edge of a PN triangle does (Vlachos et al. 2001,
Curved PN Triangles), with handles as long as a circular arc's. A crease leaves along the line in which the tangent planes of
its two sides meet, so that it stays an edge, and straight where the sides are flat.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from service.kernels.smooth_crossings import crossing_of

ROOT_STEPS = 8
"""Of regula falsi; four are enough where the normals of an edge's ends are less than 90 degrees apart."""
ENOUGH = 1e-7
"""Part of an edge within which a node is in its place: a ten-thousandth of a pixel on an edge of a thousand."""
LEAST_SINE = 0.17
"""Tangent planes that meet at less than ten degrees do not say where their crease runs."""


@njit(cache=True, nogil=True)
def dot(a, b):
    """Product of two triples."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@njit(cache=True, nogil=True)
def cross(a, b):
    """Cross product of two triples."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@njit(cache=True, nogil=True)
def mixed(a, s, b, t):
    """s a + t b."""
    return s * a[0] + t * b[0], s * a[1] + t * b[1], s * a[2] + t * b[2]


@njit(cache=True, nogil=True)
def triple(row):
    """A row of three numbers, in f8."""
    return np.float64(row[0]), np.float64(row[1]), np.float64(row[2])


@njit(cache=True, nogil=True)
def towards_eye(eye, p):
    """The way from p to a homogeneous eye, up to its length."""
    return eye[0] - eye[3] * p[0], eye[1] - eye[3] * p[1], eye[2] - eye[3] * p[2]


@njit(cache=True, nogil=True)
def _unit(v):
    length = math.sqrt(dot(v, v))
    return mixed(v, 1.0 / length, v, 0.0) if length > 0.0 else v


@njit(cache=True, nogil=True)
def _across(v, n):
    """The part of v that is perpendicular to n."""
    return mixed(v, 1.0, n, -dot(v, n) / max(dot(n, n), 1e-300))


@njit(cache=True, nogil=True)
def _in_plane(chord, n):
    """Unit direction of a chord in the plane across a normal; the chord's own where that is its normal."""
    flat = _across(chord, n)
    return _unit(flat if dot(flat, flat) > 1e-12 * dot(chord, chord) else chord)


@njit(cache=True, nogil=True)
def handle_of(turn):
    """Handle of a circular arc as a part of its chord, 1 / (3 cos^2(angle / 4)); turn: cosine of the angle of its tangents."""
    return 2.0 / (3.0 * (1.0 + math.sqrt((1.0 + max(-1.0, min(1.0, turn))) / 2.0)))


@njit(cache=True, nogil=True)
def _crease_tangent(chord, n, o):
    """Unit direction in which the tangent planes of two unit normals meet, along the chord."""
    line = cross(n, o)
    if dot(line, line) < LEAST_SINE**2:
        return _in_plane(chord, mixed(n, 1.0, o, 1.0))
    line = _unit(line)
    return line if dot(line, chord) > 0.0 else mixed(line, -1.0, line, 0.0)


@njit(cache=True, nogil=True)
def _curve(p, q, first, last):
    """Control points of the cubic from p to q with these unit tangents."""
    chord = mixed(q, 1.0, p, -1.0)
    length = handle_of(dot(first, last)) * math.sqrt(dot(chord, chord))
    return p, mixed(p, 1.0, first, length), mixed(q, 1.0, last, -length), q


@njit(cache=True, nogil=True)
def _smooth_edge(p, q, n, o):
    """Control points of the edge from p to q with normals n and o."""
    chord = mixed(q, 1.0, p, -1.0)
    return _curve(p, q, _in_plane(chord, n), _in_plane(chord, o))


@njit(cache=True, nogil=True)
def _crease_edge(p, q, left, right):
    """Control points of the crease from p to q with the normals of both ends on its left and on its right."""
    chord = mixed(q, 1.0, p, -1.0)
    return _curve(p, q, _crease_tangent(chord, left[0], right[0]), _crease_tangent(chord, left[1], right[1]))


@njit(cache=True, nogil=True)
def _on_curve(c, t):
    """(point, derivative) of a cubic."""
    s = 1.0 - t
    point = mixed(mixed(c[0], s * s * s, c[1], 3.0 * s * s * t), 1.0, mixed(c[2], 3.0 * s * t * t, c[3], t * t * t), 1.0)
    inner = mixed(mixed(c[1], 1.0, c[0], -1.0), 3.0 * s * s, mixed(c[2], 1.0, c[1], -1.0), 6.0 * s * t)
    return point, mixed(inner, 1.0, mixed(c[3], 1.0, c[2], -1.0), 3.0 * t * t)


@njit(cache=True, nogil=True)
def _turning_point(c, n, o, eye):
    """(parameter, point, normal) where the edge c turns away from the eye: its normal, from n to o, is that mixture's part across the edge.

    Regula falsi (Illinois) between ends that face differently.
    """
    low, high = 0.0, 1.0
    at_low, at_high = dot(n, towards_eye(eye, c[0])), dot(o, towards_eye(eye, c[3]))
    front = at_low >= 0.0
    t = crossing_of(at_low, at_high)
    point, along = _on_curve(c, t)
    normal = _across(mixed(n, 1.0 - t, o, t), along)
    for _ in range(ROOT_STEPS):
        value = dot(normal, towards_eye(eye, point))
        if (value >= 0.0) == front:
            low, at_low, at_high = t, value, 0.5 * at_high
        else:
            high, at_high, at_low = t, value, 0.5 * at_low
        step = low + (high - low) * min(1.0, max(0.0, crossing_of(at_low, at_high)))
        if abs(step - t) < ENOUGH:
            break
        t = step
        point, along = _on_curve(c, t)
        normal = _across(mixed(n, 1.0 - t, o, t), along)
    return t, point, normal


@njit(cache=True, nogil=True)
def _ends(e, positions, edge_vertices):
    return triple(positions[edge_vertices[e, 0]]), triple(positions[edge_vertices[e, 1]])


@njit(cache=True, nogil=True)
def _normals_of(e, side, normals, rows):
    """Normals of both ends of an edge on one side."""
    return triple(normals[rows[e, side, 0]]), triple(normals[rows[e, side, 1]])


@njit(cache=True, nogil=True)
def place_nodes(nodes, positions, normals, edge_vertices, rows, facing, eye):
    """(points (k, 3) f8, their normals (k, 3) f8, straight (k, 3) f8 their places on the mesh); zero normals at vertices."""
    points, across = np.empty((nodes.shape[0], 3)), np.zeros((nodes.shape[0], 3))
    straight = np.empty((nodes.shape[0], 3))
    count = positions.shape[0]
    for k in range(nodes.shape[0]):
        if nodes[k] < count:
            points[k, 0], points[k, 1], points[k, 2] = triple(positions[nodes[k]])
            straight[k] = points[k]
            continue
        e, side = (nodes[k] - count) // 2, (nodes[k] - count) % 2
        p, q = _ends(e, positions, edge_vertices)
        left, right = _normals_of(e, 0, normals, rows), _normals_of(e, 1, normals, rows)
        if left == right:
            t, point, normal = _turning_point(_smooth_edge(p, q, left[0], left[1]), left[0], left[1], eye)
        else:
            t = crossing_of(facing[rows[e, side, 0]], facing[rows[e, side, 1]])
            point, _ = _on_curve(_crease_edge(p, q, left, right), t)
            own = left if side == 0 else right
            normal = mixed(own[0], 1.0 - t, own[1], t)
        points[k, 0], points[k, 1], points[k, 2] = point
        across[k, 0], across[k, 1], across[k, 2] = normal
        straight[k, 0], straight[k, 1], straight[k, 2] = mixed(p, 1.0 - t, q, t)
    return points, across, straight


@njit(cache=True, nogil=True)
def _along_crease(node, e, positions, normals, edge_vertices, rows, facing):
    """Direction of the crease e at one of its nodes."""
    t = 0.0 if node == edge_vertices[e, 0] else 1.0
    if node >= positions.shape[0]:
        side = (node - positions.shape[0]) % 2
        t = crossing_of(facing[rows[e, side, 0]], facing[rows[e, side, 1]])
    p, q = _ends(e, positions, edge_vertices)
    return _on_curve(_crease_edge(p, q, _normals_of(e, 0, normals, rows), _normals_of(e, 1, normals, rows)), t)[1]


@njit(cache=True, nogil=True)
def end_tangents(nodes, following, crease, points, across, positions, normals, edge_vertices, rows, facing, eye):
    """(k, 2, 3) f8: directions, up to their sign, at the ends of the pieces from each node to its following one.

    crease (k,) i8: the edge that a piece runs along, or -1 where it crosses a face; there it is perpendicular to normal and view.
    """
    out = np.empty((nodes.shape[0], 2, 3))
    for k in range(nodes.shape[0]):
        for end in range(2):
            i = np.int64(k) if end == 0 else np.int64(following[k])
            if crease[k] >= 0:
                d = _along_crease(nodes[i], crease[k], positions, normals, edge_vertices, rows, facing)
            else:
                d = cross(triple(across[i]), towards_eye(eye, points[i]))
            out[k, end, 0], out[k, end, 1], out[k, end, 2] = d
    return out
