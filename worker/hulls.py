"""Hulls of other sizes than was asked for, with maps over each: one of fewer faces and one of more, for a planner to choose from."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from geometry.hull_sequence import cut_hull
from geometry.topology import signed_volume
from schemas.conventions import F4, I4, Array
from worker.bake import Maps, bake_maps, hull_normals

FACTOR = 4
"""The coarser hull has so many times fewer faces than the drawn one, the finer so many times more."""
FEWEST_FACES = 64
FINEST_PART = 0.5
"""Of the mesh's faces: a hull of more saves nothing."""
NEARLY = 1.5
"""How far a sequence's last hull may be above the size that is wanted."""


@dataclass(frozen=True)
class OtherHull:
    """positions (hv, 3) f4, faces (hf, 3) i4, normals (hv, 3) f4 as of the drawn hull; maps over it; volume_excess of the mesh's volume."""

    positions: F4
    faces: I4
    normals: F4
    maps: Maps
    volume_excess: float

    def tensors(self) -> dict[str, Array]:
        """Tensors of `artifacts.HULL`."""
        return {"positions": self.positions, "faces": self.faces, "normals": self.normals}


def other_sizes(mesh_faces: int, drawn_faces: int) -> list[int]:
    """Faces of the hulls that are worth having beside a drawn one, the coarser first."""
    sizes = [drawn_faces // FACTOR, FACTOR * drawn_faces]
    return [size for size in sizes if FEWEST_FACES <= size <= FINEST_PART * mesh_faces]


def build_other_hull(
    mesh: dict[str, Any],
    appearance: dict[str, Any] | None,
    steps: tuple[I4, F4],
    faces: int,
    texels: int,
    progress: Callable[[float], None],
) -> OtherHull | None:
    """The hull of at most so many faces, cut from the sequence; None where the sequence does not come near to that.

    mesh, appearance: tensors of `artifacts.MESH` and `APPEARANCE`; steps: of `artifacts.HULL_SEQUENCE`. What progress raises goes through.
    """
    original = (mesh["positions"], mesh["faces"])
    positions, triangles = cut_hull(*original, *steps, faces)
    if len(triangles) > NEARLY * faces:
        return None
    normals = hull_normals(positions, triangles)
    rows = mesh.get("corner_normals")
    maps = bake_maps(positions, triangles, normals, *original, mesh["normals"], appearance, texels, progress, corner_normals=rows)
    volume = signed_volume(*original)
    gained = signed_volume(positions, triangles) - volume
    return OtherHull(positions, triangles, normals, maps, gained / volume if volume > 0.0 else 0.0)
