"""A mesh in the shape that a scene gives it, for what depends on its angles: which edges are ridges, and which faces are seen edge-on.

A placement that only turns, mirrors and scales leaves angles as they are, and the eye is moved instead (`service.scene.place`).
"""

from __future__ import annotations

import hashlib
from dataclasses import replace

import numpy as np

from schemas.conventions import F8
from schemas.mesh import Capability
from service.assets import MeshAsset
from service.scene.place import Placement
from service.silhouette.extract import frozen

STRETCHED = 1e-6
"""Part by which the axes of a placed sphere must differ to count as different."""
KEPT = 4
"""Stretched forms of a mesh that are kept for the next picture."""


def in_shape(asset: MeshAsset, placement: Placement) -> tuple[MeshAsset, Placement]:
    """The mesh stretched, and the placement without that: the same picture, from a mesh whose angles are the scene's.

    The mesh and its placement themselves where nothing is stretched. What the answer has is what lines are drawn from: it has no hull,
    tree or levels.
    """
    turn, axes, rows = np.linalg.svd(placement.linear)
    if axes[2] >= axes[0] * (1.0 - STRETCHED):
        return asset, placement
    # a stretch that mirrors would turn faces over: it is left in the placement
    side = -1.0 if np.linalg.det(rows) < 0.0 else 1.0
    stretch = side * axes[:, None] * rows
    return _stretched(asset, stretch), Placement(placement.frame, side * turn)


def _stretched(asset: MeshAsset, stretch: F8) -> MeshAsset:
    """The mesh with vertices multiplied by `stretch` (3, 3) f8, of positive determinant; the latest few are kept with it."""
    kept, key = asset.stretched, np.ascontiguousarray(stretch).tobytes()
    made = kept.pop(key, None) or _made(asset, stretch, hashlib.blake2b(key, digest_size=16).hexdigest())
    kept[key] = made
    for earlier in list(kept)[:-KEPT]:
        kept.pop(earlier, None)
    return made


def _made(asset: MeshAsset, stretch: F8, digest: str) -> MeshAsset:
    normals = np.asarray(asset.normals, np.float64) @ np.linalg.inv(stretch)
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    return replace(
        asset,
        id=f"{asset.id} stretched {digest}",
        positions=frozen(np.asarray(asset.positions, np.float64) @ stretch.T, np.float32),
        normals=frozen(np.divide(normals, length, out=np.zeros_like(normals), where=length > 0.0), np.float32),
        hull=None,
        maps=None,
        tree=None,
        clip=Capability(available=False, reason="the mesh is stretched"),
        levels=(),
        other_hulls=(),
        ladder=None,
    )
