"""The facing rule and silhouettes in rational arithmetic: slow, short, and independent of every predicate of the product."""

from __future__ import annotations

from collections import defaultdict
from fractions import Fraction

import numpy as np


def _rational(point):
    return [Fraction(float(x)) for x in point]


def orientation(a, b, c, eye):
    """Sign of det[b - a, c - a, eye - w a] for (3,) corners and a homogeneous eye (4,)."""
    a, b, c, (x, y, z, w) = _rational(a), _rational(b), _rational(c), _rational(eye)
    u, v = [q - p for p, q in zip(a, b, strict=True)], [q - p for p, q in zip(a, c, strict=True)]
    d = [x - w * a[0], y - w * a[1], z - w * a[2]]
    cross = [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]]
    value = sum(p * q for p, q in zip(cross, d, strict=True))
    return (value > 0) - (value < 0)


def facing(positions, faces, eye):
    """(f,) bool: on or outside the plane."""
    return np.array([orientation(positions[i], positions[j], positions[k], eye) >= 0 for i, j, k in faces])


def silhouette(positions, faces, eye):
    """Set of directed edges (v0, v1) whose left face is front-facing and whose right face is not, from the faces alone."""
    return silhouette_of(facing(positions, faces, eye), faces)


def silhouette_of(front, faces):
    """The same for faces of which is known whether they are front-facing, (f,) bool."""
    sides = defaultdict(dict)
    for number, (i, j, k) in enumerate(faces.tolist()):
        for edge in ((i, j), (j, k), (k, i)):
            sides[edge]["left"] = number
            sides[edge[::-1]]["right"] = number
    return {edge for edge, side in sides.items() if front[side["left"]] and not front[side["right"]]}


def edge_set(edges):
    """(s, 2) array -> set of tuples; two equal rows fail."""
    found = {(int(a), int(b)) for a, b in edges}
    assert len(found) == len(edges), "an edge came twice"
    return found
