"""Which level of a mesh is close enough to the mesh for a view: the view-adapted silhouettes of Silhouette Clipping, section 7.

A level encloses the mesh, and no point of it is further from the mesh than its bound. So in an image the mesh's shape lies
inside the level's shape, and every point of the level's shape is within `error_px` of the mesh's.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from schemas.conventions import F4, F8, I4, Array
from service.camera import View
from service.kernels.choose_rung import pixels_per_unit
from service.silhouette.extract import SilhouetteTree

ROUNDING = 1e-9
"""Part by which a computed bound in pixels, or a depth, may be off."""


@dataclass(frozen=True)
class SilhouetteLevel:
    """A level, mapped from its artifacts; tensors of `schemas.artifacts.LEVELS` and `LEVEL_TREES` by name."""

    mesh: Mapping[str, Array]
    stored_tree: Mapping[str, Array]

    @property
    def positions(self) -> F4:
        """(v, 3) f4 in the normalised frame of the mesh."""
        return np.asarray(self.mesh["positions"], np.float32)

    @property
    def faces(self) -> I4:
        """(f, 3) i4."""
        return np.asarray(self.mesh["faces"], np.int32)

    @property
    def bound(self) -> float:
        """No point of the level is further than this from the mesh, normalised units."""
        return float(self.mesh["bound"][0])

    @cached_property
    def tree(self) -> SilhouetteTree:
        """Its search tree, packed when it is first asked for. Raises CorruptArtifactError."""
        return SilhouetteTree(self.mesh, self.stored_tree)

    @property
    def nbytes(self) -> int:
        """Bytes of all arrays."""
        return sum(int(array.nbytes) for part in (self.mesh, self.stored_tree) for array in part.values())


class LevelInView(NamedTuple):
    """A level, and how far its shape in the image can be beyond the mesh's, pixels."""

    level: SilhouetteLevel
    error_px: float


def choose_level(levels: Sequence[SilhouetteLevel], view: View, corners: F8, most_px: float) -> LevelInView | None:
    """The level of the fewest faces whose error in this view is at most most_px; None where the mesh itself must do.

    corners: (8, 3) f8 of the mesh's bounding box.
    """
    for level in sorted(levels, key=lambda one: len(one.faces)):
        error_px = projected_px(view, corners, level.bound)
        if error_px <= most_px:
            return LevelInView(level, error_px)
    return None


class Scale(NamedTuple):
    """Of `service.kernels.choose_rung.pixels_per_unit`, rounded up."""

    pixels: float
    limit: float

    def of(self, bound: float) -> float:
        """Pixels within which two points are in the image when they are within `bound` of each other, normalised units."""
        return bound * self.pixels if bound < self.limit else np.inf


def scale_of(view: View, corners: F8) -> Scale:
    """The scale of a view at its nearest point of the box with these corners (8, 3) f8."""
    pixels, limit = pixels_per_unit(view.pixels, corners, float(view.width), float(view.height))
    return Scale(pixels * (1.0 + ROUNDING), limit * (1.0 - ROUNDING))


def projected_px(view: View, corners: F8, bound: float) -> float:
    """Pixels within which two points are in the image when they are within `bound` of each other, normalised units.

    One of them is in the box with these corners (8, 3) f8 and the other is seen in the image. Infinite where the box comes so near
    to the eye plane, or is behind it, that nothing can be said; what is within `bound` of the box is otherwise in front of the eye.
    """
    return scale_of(view, corners).of(bound)


def rounded_up(error_px: float) -> str:
    """A bound in pixels with six digits, not less than it is."""
    text = f"{error_px:.6g}"
    return text if float(text) >= error_px else f"{error_px * (1.0 + 1e-5):.6g}"
