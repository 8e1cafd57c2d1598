"""Meshes as uploads leave them, and ways to move their vertices."""

from __future__ import annotations

from itertools import count

import numpy as np

from benchmarks.lines import original_of
from schemas.mesh import PreprocessOptions
from worker.load import build
from worker.loading.parsed import Parsed

_NUMBERS = count()


def read(mesh, colors=None, repair="auto"):
    """(MeshAsset of its own id, vertices (v, 3) f8 model units in its order): a mesh read as an upload is. colors: (v, 4) u1."""
    vertices, faces = mesh
    faces = np.asarray(faces, np.int32)
    appearance = {} if colors is None else {"corner_color": np.asarray(colors, np.uint8)[faces]}
    loaded = build(Parsed(np.asarray(vertices, np.float64), faces, appearance), PreprocessOptions(repair=repair))
    asset = original_of(loaded, f"read {next(_NUMBERS)}")
    places = {tuple(p): i for i, p in enumerate(asset.frame.to_normalised(vertices).astype(np.float32).tolist())}
    return asset, np.asarray(vertices, np.float64)[[places[tuple(p)] for p in asset.positions.tolist()]]


def bent(vertices, turn=1.2):
    """Bent about y, the more the higher along x."""
    x, y, z = vertices.T
    low, high = x.min(), x.max()
    angle = turn * (x - low) / (high - low)
    return np.column_stack([low + (z + 3.0) * np.sin(angle), y, (z + 3.0) * np.cos(angle) - 3.0])


def rotated(vertices, scale=1.0, shift=(0.0, 0.0, 0.0)):
    """Turned by 40 degrees about an axis of no symmetry, scaled, shifted."""
    axis = np.array([0.3, 0.9, -0.2]) / np.linalg.norm([0.3, 0.9, -0.2])
    cross = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
    turn = np.eye(3) + np.sin(0.7) * cross + (1.0 - np.cos(0.7)) * cross @ cross
    return scale * np.asarray(vertices) @ turn.T + np.asarray(shift)
