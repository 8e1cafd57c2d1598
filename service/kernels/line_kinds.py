"""Which edges of a mesh are lines, and of which kind: by how faces meet at them, and by how an eye sees these faces.

Based on: Fast Silhouettes (GameDev.net, 2007), sections Silhouette rendering and Algorithm Overview (outlines, ridges and creases); a
boundary, which that leaves out, is an edge of one face. Departs from it: facing and convexity are decided exactly, valleys have an
angle of their own, and edges of more than two faces are creases.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from geometry.predicates import orient_sign

SILHOUETTE, BOUNDARY, RIDGE, VALLEY, CREASE, INTERSECTION = 0, 1, 2, 3, 4, 5
"""Kinds, in the order in which an edge that is several is one of them."""
KINDS = 6
CONVEX, CONCAVE, FLAT = 1, -1, 0
ALONE, PAIR, TWISTED, MANY = 1, 2, 3, 4
"""How many faces share an edge: one, two, two that are turned against each other, more."""


@njit(cache=True, inline="always")
def corner(positions, i):
    """Position i of (v, 3) as three f8."""
    return np.float64(positions[i, 0]), np.float64(positions[i, 1]), np.float64(positions[i, 2])


@njit(cache=True, nogil=True)
def eye_sides(positions, faces, eye):
    """(f,) i1: exactly on which side of each face the eye (4,) f8 is: 1 outside, 0 in its plane, -1 inside."""
    sides = np.empty(faces.shape[0], np.int8)
    x, y, z, w = eye[0], eye[1], eye[2], eye[3]
    for f in range(faces.shape[0]):
        a, b, c = corner(positions, faces[f, 0]), corner(positions, faces[f, 1]), corner(positions, faces[f, 2])
        sides[f] = orient_sign(a, b, c, x, y, z, w)
    return sides


@njit(cache=True, nogil=True)
def edge_shapes(positions, faces, normals, starts, halves):
    """(meeting (e,) u1, turn (e,) i1, angle (e,) f8): what is about each edge, whether it is CONVEX, and by how much normals turn, radians.

    normals (f, 3) f8 unit, or zero where there is none; starts, halves: `geometry.edge_fans`. turn and angle are FLAT and 0 of edges
    that not two faces share; a twisted pair has an angle, that of its planes, and no turn.
    """
    count = starts.shape[0] - 1
    meeting, turn, angle = np.empty(count, np.uint8), np.zeros(count, np.int8), np.zeros(count)
    for e in range(count):
        number = starts[e + 1] - starts[e]
        if number != 2:
            meeting[e] = ALONE if number == 1 else MANY
            continue
        h, g = halves[starts[e]], halves[starts[e] + 1]
        f, other = h // 3, g // 3
        twisted = faces[f, h % 3] == faces[other, g % 3]
        meeting[e] = TWISTED if twisted else PAIR
        flip = -1.0 if twisted else 1.0
        ax, ay, az = normals[f, 0], normals[f, 1], normals[f, 2]
        bx, by, bz = flip * normals[other, 0], flip * normals[other, 1], flip * normals[other, 2]
        if (ax == 0.0 and ay == 0.0 and az == 0.0) or (bx == 0.0 and by == 0.0 and bz == 0.0):
            continue
        cx, cy, cz = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
        angle[e] = np.arctan2(np.sqrt(cx * cx + cy * cy + cz * cz), ax * bx + ay * by + az * bz)
        if not twisted:
            x, y, z = corner(positions, faces[other, (g % 3 + 2) % 3])
            a, b, c = corner(positions, faces[f, 0]), corner(positions, faces[f, 1]), corner(positions, faces[f, 2])
            turn[e] = -orient_sign(a, b, c, x, y, z, 1.0)
    return meeting, turn, angle


@njit(cache=True, nogil=True)
def contour_edges(sides, starts, halves, meeting):
    """(c,) i4: edges beside which the surface may end in the image: silhouettes, boundaries, and all where more than two faces meet.

    sides: `eye_sides`. A twisted pair is a silhouette where both faces are seen from the same side, or edge-on.
    """
    found = np.empty(meeting.shape[0], np.int32)
    count = 0
    for e in range(meeting.shape[0]):
        if meeting[e] == PAIR or meeting[e] == TWISTED:
            one, two = sides[halves[starts[e]] // 3], sides[halves[starts[e] + 1] // 3]
            is_contour = (one >= 0) != (two >= 0) if meeting[e] == PAIR else one * two >= 0
        else:
            is_contour = True
        found[count] = e
        count += is_contour
    return found[:count].copy()


@njit(cache=True, nogil=True)
def line_edges(sides, starts, halves, meeting, turn, angle, wanted, angles):
    """(edges (l,) i4, kinds (l,) u1): the edges that are lines, each as the first of its kinds that is wanted.

    wanted (KINDS,) bool; angles (KINDS,) f8 radians: that normals must turn by more than, of RIDGE, VALLEY and CREASE.
    """
    edges, kinds = np.empty(meeting.shape[0], np.int32), np.empty(meeting.shape[0], np.uint8)
    count = 0
    for e in range(meeting.shape[0]):
        kind = KINDS
        if meeting[e] == ALONE:
            kind = BOUNDARY if wanted[BOUNDARY] else KINDS
        elif meeting[e] == MANY:
            kind = CREASE if wanted[CREASE] else KINDS
        else:
            one, two = sides[halves[starts[e]] // 3], sides[halves[starts[e] + 1] // 3]
            differ = (one >= 0) != (two >= 0) if meeting[e] == PAIR else one * two > 0
            if wanted[SILHOUETTE] and differ:
                kind = SILHOUETTE
            elif wanted[RIDGE] and turn[e] == CONVEX and angle[e] > angles[RIDGE]:
                kind = RIDGE
            elif wanted[VALLEY] and turn[e] == CONCAVE and angle[e] > angles[VALLEY]:
                kind = VALLEY
            elif wanted[CREASE] and angle[e] > angles[CREASE] and (turn[e] != FLAT or meeting[e] == TWISTED):
                kind = CREASE
        edges[count], kinds[count] = e, kind
        count += kind != KINDS
    return edges[:count].copy(), kinds[:count].copy()
