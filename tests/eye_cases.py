"""Eyes in awkward places of a normalised mesh."""

from __future__ import annotations

import numpy as np
from hypothesis import strategies as st

_near = st.floats(-4, 4, allow_subnormal=False).filter(lambda x: x == 0 or abs(x) > 1e-12)
_round = st.integers(-16, 16).map(lambda i: i / 8.0)
_far = st.sampled_from([-1e12, -1e3, 0.0, 1.0, 1e3, 1e12])


def strategy():
    """Homogeneous eyes (4,) f8: near, on a grid (planes of generated meshes), far, and at infinity."""
    places = st.one_of(*(st.tuples(c, c, c) for c in (_near, _round, _far)))
    directions = places.filter(lambda d: max(map(abs, d)) > 1e-3)
    return st.one_of(
        places.map(lambda p: np.array([*p, 1.0])),
        directions.map(lambda d: np.array([*(np.array(d) / np.linalg.norm(d)), 0.0])),
    )


def awkward(positions, faces):
    """Label -> eye: on vertices, edges and planes, inside, very near, very far, along faces from infinity."""
    p = np.asarray(positions, np.float64)
    a, b, c = p[faces[0]]
    normal = np.cross(b - a, c - a)
    normal /= np.linalg.norm(normal)
    axes = {f"from infinity along {s}{'xyz'[k]}": np.array([*(s * np.eye(3)[k]), 0.0]) for k in range(3) for s in (1.0, -1.0)}
    along = (b - a) / np.linalg.norm(b - a)
    return axes | {
        "on a vertex": np.array([*a, 1.0]),
        "on an edge": np.array([*(a + b) / 2.0, 1.0]),
        "in a face": np.array([*(a + b + c) / 3.0, 1.0]),
        "on a plane": np.array([*(a + 2.0 * (b - a) + 3.0 * (c - a)), 1.0]),
        "barely outside": np.array([*((a + b + c) / 3.0 + 1e-9 * normal), 1.0]),
        "barely inside": np.array([*((a + b + c) / 3.0 - 1e-9 * normal), 1.0]),
        "at the centre": np.array([0.0, 0.0, 0.0, 1.0]),
        "far": np.array([1e12, -2e12, 0.5e12, 1.0]),
        "beyond single precision": np.array([1e45, 2e40, -1e44, 1.0]),
        "from infinity along an edge": np.array([*along, 0.0]),
        "from infinity against a normal": np.array([*-normal, 0.0]),
        "a direction that is not unit": np.array([0.0, 3e-40, 4e-40, 0.0]),
    }
