"""Places to stand about a mesh where computed signs are zero or nearly so, and places that no view is meant for."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from schemas.conventions import Frame
from tests.oracles_hull import winding_numbers

UNIT = Frame((0.0, 0.0, 0.0), 1.0)
NEAR, FAR = 1e-9, 1e12
"""Normalised units, that is radii of the mesh."""


def unframed(asset):
    """The asset in a frame that moves nothing, so that eyes in model units are those of the normalised frame, bit by bit."""
    return replace(asset, frame=UNIT)


def at(point):
    """A place as a homogeneous eye (4,) f8."""
    return np.array([*np.asarray(point, np.float64), 1.0])


def towards(direction):
    """An eye at infinity; not made unit, so that it lies exactly in the planes that the direction lies in."""
    return np.array([*np.asarray(direction, np.float64), 0.0])


def standpoints(positions, faces, hull=None):
    """Label -> eye (4,) f8. hull: (positions, faces) of one about the mesh, for places between the two."""
    p = np.asarray(positions, np.float64)
    a, b, c = p[faces[len(faces) // 3]]
    middle = (a + b + c) / 3.0
    normal = np.cross(b - a, c - a)
    normal /= np.linalg.norm(normal)
    eyes = {
        "on a face's plane": at(a + 2.0 * (b - a) + 3.0 * (c - a)),
        "on an edge's line": at(2.0 * b - a),
        "on the ray through a vertex": at(2.0 * a),
        "on a line through two vertices": at(2.0 * a - p[faces[0, 0]]),
        "in a face": at(middle),
        "on an edge": at((a + b) / 2.0),
        "at a vertex": at(a),
        "hardly outside a face": at(middle + NEAR * normal),
        "hardly inside a face": at(middle - NEAR * normal),
        "hardly off an edge": at((a + b) / 2.0 + NEAR * normal),
        "hardly off a vertex": at(a + NEAR * normal),
        "close to a face": at(middle + 1e-4 * normal),
        "close to an edge": at((a + b) / 2.0 + 1e-5 * normal),
        "close to a vertex": at(a * (1.0 + 1e-5)),
        "very far along an axis": at([0.0, 0.0, FAR]),
        "very far": at(FAR * np.array([0.3, -0.8, 0.52])),
        "very far on a face's plane": at(middle + FAR * (b - a)),
        "at infinity along a face": towards((b - a) + 2.0 * (c - a)),
        "at infinity along an edge": towards(b - a),
        "at infinity over a face": towards(normal),
        "at infinity along an axis": towards([0.0, 1.0, 0.0]),
        "at infinity": towards([0.3, -0.8, 0.52]),
    }
    inside = _somewhere(p, lambda points: winding_numbers(p, faces, points) > 0.99)
    eyes |= {} if inside is None else {"inside": at(inside)}
    if hull is not None:
        between = _somewhere(hull[0], lambda x: (winding_numbers(*hull, x) > 0.99) & (np.abs(winding_numbers(p, faces, x)) < 0.01))
        highest = np.asarray(hull[0][np.argmax(np.linalg.norm(hull[0], axis=1))], np.float64)
        eyes["close to a vertex of the hull"] = at(highest * (1.0 + 1e-5))
        eyes |= {} if between is None else {"inside the hull only": at(between)}
    return eyes


def _somewhere(positions, holds):
    """A point near the surface that a predicate of points (n, 3) holds for; None where none is found."""
    rng = np.random.default_rng(11)
    p = np.asarray(positions, np.float64)
    points = p[rng.integers(0, len(p), 600)] * rng.uniform(0.7, 1.01, (600, 1)) + rng.normal(size=(600, 3)) * 0.05
    found = points[holds(points)]
    return found[0] if len(found) else None


def framed(asset, eye, width, height, *, aside=False):
    """Camera fields of an eye that looks at the middle of the mesh, or aside past it; such that the mesh fills the picture's middle."""
    x, y, z, w = eye
    if w == 0.0:
        unit = eye[:3] / np.linalg.norm(eye[:3])
        return {"eye": unit.tolist(), "target": [0.0, 0.0, 0.0], "up": _up(unit), "projection": "orthographic", "height": 2.1}
    distance = float(np.linalg.norm([x, y, z]))
    target = np.array([0.001, 0.002, -0.003])
    view = target - eye[:3]
    fov = 70.0 if distance < 3.0 else float(np.degrees(2.0 * np.arctan(1.05 / distance)))
    if aside and distance < 3.0:
        view = np.cross(view, _up(view)) - 0.3 * view
        target = eye[:3] + view
    return {"eye": [x, y, z], "target": target.tolist(), "up": _up(view), "fov_y_deg": fov}


def _up(view):
    """Some direction across the view, away from the image's symmetries."""
    axis = np.eye(3)[int(np.argmin(np.abs(view)))]
    return (axis + 0.2).tolist()
