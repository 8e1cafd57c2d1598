"""Hulls of any size, cut from the stored sequences when they are asked for."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from backend.artifacts import read_artifact
from backend.glb import bare_glb
from backend.store import Store
from geometry.hull_sequence import cut_hull
from geometry.topology import signed_volume
from schemas import artifacts
from schemas.conventions import I4
from schemas.errors import CapabilityError, InvalidRequestError
from schemas.manifest import Manifest
from service.assets import CLIP, MeshAsset


class Side(StrEnum):
    """Which hull: one that encloses the mesh, or one that the mesh encloses."""

    OUTER = "outer"
    INNER = "inner"


SEQUENCES = {Side.OUTER: artifacts.HULL_SEQUENCE, Side.INNER: artifacts.INNER_SEQUENCE}
CAPABILITIES = {Side.OUTER: CLIP, Side.INNER: "inner"}


@dataclass(frozen=True)
class HullFile:
    """A hull as binary glTF. volume_excess: as in `schemas.mesh.HullLevel`."""

    data: bytes
    faces: int
    volume_excess: float


def require_hulls(manifest: Manifest, side: Side) -> None:
    """Raise CapabilityError when the mesh has no hulls of that side."""
    clip = manifest.capabilities.get(CLIP)
    found = manifest.capabilities.get(CAPABILITIES[side], clip if clip is not None and not clip.available else None)
    if found is None or not found.available:
        raise CapabilityError((found and found.reason) or "the mesh was not prepared for this", field="side")


def hull_file(store: Store, asset: MeshAsset, side: Side, faces: int) -> HullFile:
    """The hull of at most so many faces: as many, or one less, since a collapse takes two.

    Raises InvalidRequestError when that is fewer than this mesh's topology allows, or more than the mesh itself has.
    """
    layout, original = SEQUENCES[side], len(asset.faces)
    sequence = read_artifact(store, asset.id, layout)
    steps: I4 = np.asarray(sequence["step_vertices"], np.int32)
    fewest = original - 2 * int(np.count_nonzero((steps[:, 0] >= 0) & (steps[:, 1] >= 0)))
    if faces < fewest:
        message = f"The {side.value} hulls of this mesh have {fewest} faces or more."
        raise InvalidRequestError(message, field="faces", fewest=fewest, most=original)
    if faces > original:
        message = f"The mesh itself has {original} faces; a hull of it has that many at most."
        raise InvalidRequestError(message, field="faces", fewest=fewest, most=original)
    positions, triangles = cut_hull(asset.positions, asset.faces, steps, sequence["step_positions"], faces)
    volume = signed_volume(asset.positions, asset.faces)
    gained = signed_volume(positions, triangles) - volume
    data = bare_glb(f"{side.value} hull", positions, triangles, asset.frame)
    return HullFile(data, len(triangles), gained / volume if volume > 0.0 else 0.0)
