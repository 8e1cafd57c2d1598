"""Hulls of other sizes than was asked for, with maps: what can be drawn when a picture may cost less, or is to be shaded better.

The coarser one is a hull of the drawn hull (`worker.hull`, Silhouette Clipping section 3): what encloses that encloses the mesh, and it
takes a blink, where the stored sequence ends at the drawn hull's size. The finer one is cut from the stored sequence.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from geometry.hull_sequence import cut_hull
from schemas.conventions import F4, I4
from schemas.errors import CorruptArtifactError
from worker.bake import bake_hull, hull_normals
from worker.hull import build_hull
from worker.verify import Tensors, verify_hull

RATIO = 4
"""Faces of the drawn hull over those of the coarser one, and of the finer one over those of the drawn one."""
FEWEST_FACES = 64
"""Of a coarser hull: below that drawing is as fast."""
LARGEST_SHARE = 0.6
"""Of the drawn hull's faces that a coarser hull may have where topology keeps it from its size: with more it saves next to nothing."""
FINEST_SHARE = 0.5
"""Of the mesh's faces that a finer hull may have."""
_MADE, _BAKED = 0.1, 0.7
"""Parts of a hull's time after which it is made and its maps are baked."""

Progress = Callable[[float], None]


class LeftOutError(Exception):
    """A mesh has no such hull; the message says why."""


@dataclass(frozen=True)
class OtherHull:
    """A hull and its maps as they are stored: tensors of `schemas.artifacts` OTHER_HULLS and OTHER_MAPS by name.

    volume_excess: as of the drawn hull, None where the original has no volume.
    """

    hull: Tensors
    maps: Tensors
    volume_excess: float | None


@dataclass(frozen=True)
class HullSource:
    """What other hulls are made of: tensors of MESH, of HULL and of HULL_SEQUENCE; APPEARANCE, if the mesh has colour.

    texels: longest side of the maps.
    """

    mesh: Tensors
    drawn: Tensors
    sequence: Tensors
    appearance: Tensors | None
    texels: int

    def coarser(self, progress: Progress) -> OtherHull:
        """The hull of a quarter of the drawn hull's faces, checked. Raises LeftOutError, CorruptArtifactError when it is at fault."""
        faces = len(self.drawn["faces"])
        wanted = faces // RATIO
        if wanted < FEWEST_FACES:
            raise LeftOutError(f"a coarser hull of {wanted} faces would not be faster than the drawn one of {faces}")
        made = build_hull(self.drawn["positions"], self.drawn["faces"], wanted, lambda part: progress(_MADE * part))
        if len(made.faces) > LARGEST_SHARE * faces:
            raise LeftOutError(f"the mesh's topology lets no coarser hull have fewer than {len(made.faces)} of {faces} faces")
        return self._baked(made.positions, made.faces, progress)

    def finer(self, progress: Progress) -> OtherHull:
        """The hull of four times the drawn hull's faces, checked; raises the same."""
        wanted, most = RATIO * len(self.drawn["faces"]), int(FINEST_SHARE * len(self.mesh["faces"]))
        if wanted > most:
            raise LeftOutError(f"a finer hull of {wanted} faces would have more than half of the mesh's {len(self.mesh['faces'])}")
        steps = (self.sequence["step_vertices"], self.sequence["step_positions"])
        return self._baked(*cut_hull(self.mesh["positions"], self.mesh["faces"], *steps, wanted), progress)

    def _baked(self, positions: F4, faces: I4, progress: Progress) -> OtherHull:
        progress(_MADE)
        hull: Tensors = {"positions": positions, "faces": faces, "normals": hull_normals(positions, faces)}
        baked = bake_hull(self.mesh, hull, self.appearance, self.texels, lambda part: progress(_MADE + (_BAKED - _MADE) * part))
        maps = baked.tensors()
        checked = verify_hull(self.mesh, hull, maps)
        progress(1.0)
        return OtherHull(hull, maps, checked["volume_excess"])


def other_hulls(source: HullSource, progress: Progress) -> tuple[tuple[OtherHull | None, OtherHull | None], list[str]]:
    """(coarser, finer), None where it is left out, and why each one that is was."""
    made: list[OtherHull | None] = []
    left_out = []
    for number, make in enumerate((source.coarser, source.finer)):

        def report(part: float, number: int = number) -> None:
            progress(0.5 * (number + part))

        try:
            made.append(make(report))
        except LeftOutError as reason:
            left_out.append(str(reason))
        except CorruptArtifactError as fault:
            left_out.append(f"it did not pass the checks: {fault.message}")
        if len(made) == number:
            made.append(None)
    return (made[0], made[1]), left_out


def described(one: OtherHull) -> dict[str, Any]:
    """What the report says of a hull."""
    return {"faces": len(one.hull["faces"]), "texels": max(one.maps["normal"].shape[:2]), "volume_excess": one.volume_excess}
