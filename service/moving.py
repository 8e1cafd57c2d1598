"""Meshes whose vertices are moved for one request: the same faces at other positions.

Based on: Fast Silhouettes, the last paragraph of "Rendering Implementation" (models that deform). What depends on the faces alone is shared
with the mesh as it was loaded: edges, creases, adjacency, colours. Positions, normals and what follows from them are new. Hulls, maps,
levels and the search tree belong to the mesh at rest: none of them goes along.
"""

from __future__ import annotations

import secrets
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from geometry.topology import corner_normals
from schemas.conventions import F4, Array
from schemas.errors import InvalidRequestError
from schemas.mesh import Capability
from service.assets import MeshAsset
from service.silhouette.extract import frozen

Flags = npt.NDArray[np.bool_]

FIELD = "positions"
"""Field of a form that positions come in, and that faults name."""
FARTHEST_RADII = 1e6
"""Positions farther from the middle of the mesh at rest are refused: its own size would be lost in the depth of a picture."""
NOT_CLIPPED = "a mesh whose vertices are moved has no hull to clip: its hull is that of the mesh at rest"


class Moving:
    """A mesh that moves as long as a request lasts. id: what the renderer keeps of it is under this, and is to be dropped at the end."""

    def __init__(self, base: MeshAsset) -> None:
        self.base = base
        self.id = f"{base.id} moving {secrets.token_hex(8)}"

    def at(self, positions: Array) -> MeshAsset:
        """The mesh with its vertices at positions (v, 3), f4 or f8 model units, in the order of the stored mesh.

        Normals follow by the rule of loading, with the creases of the mesh at rest. Raises InvalidRequestError for other numbers of
        positions, and for those that are no numbers or too far away.
        """
        base = self.base
        placed = normalised(base, positions)
        normals = corner_normals(placed, base.faces, base.shading_faces, len(base.normals))
        moved = replace(
            base,
            id=self.id,
            positions=frozen(placed, np.float32),
            normals=frozen(normals, np.float32),
            hull=None,
            maps=None,
            tree=None,
            clip=Capability(available=False, reason=NOT_CLIPPED),
            levels=(),
            other_hulls=(),
            ladder=None,
            base=base,
        )
        _ = moved.radius, moved.corners, moved.encloses  # what any picture asks for is worked out here, not by the renderer
        return moved


def normalised(base: MeshAsset, positions: Array) -> F4:
    """(v, 3) f4 in the frame of the mesh at rest. Raises InvalidRequestError."""
    count = len(base.positions)
    if positions.shape != (count, 3):
        given = f"{len(positions):,}" if positions.ndim == 2 and positions.shape[1] == 3 else f"an array of {positions.shape}"
        raise InvalidRequestError(f"the mesh has {count:,} vertices, but there are positions of {given}", field=FIELD, vertices=count)
    with np.errstate(over="ignore", invalid="ignore"):
        placed = base.frame.to_normalised(positions)
    if not np.abs(placed).max() <= FARTHEST_RADII:
        _refuse(base, np.asarray(~np.isfinite(placed).all(axis=1)), "not finite")
        _refuse(base, np.asarray((np.abs(placed) > FARTHEST_RADII).any(axis=1)), f"farther than {FARTHEST_RADII:,.0f} radii from the mesh")
    return placed.astype(np.float32)


def _refuse(base: MeshAsset, wrong: Flags, what: str) -> None:
    if wrong.any():
        first, count = int(np.argmax(wrong)), int(np.count_nonzero(wrong))
        message = f"{count:,} of {len(base.positions):,} positions are {what}, the first of them that of vertex {first}"
        raise InvalidRequestError(message, field=FIELD, vertex=first, count=count)
