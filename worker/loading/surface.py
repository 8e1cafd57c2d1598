"""The mesh between the repair steps."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from schemas.conventions import F4, Array, F8


@dataclass(frozen=True)
class Surface:
    """An indexed mesh whose corners remember where they came from.

    positions (v, 3) f4 normalised; faces (f, 3) i8 vertices; corners (f, 3) i8: the corner 3 * face + k of the parsed file
    that each corner takes its colour and texture coordinate from.
    """

    positions: F4
    faces: Array
    corners: Array

    def kept(self, which: Array) -> Surface:
        """Only the faces of a mask or index array."""
        return replace(self, faces=self.faces[which], corners=self.corners[which])

    def flipped(self, which: Array) -> Surface:
        """With the faces of a (f,) mask turned round."""
        order = np.where(np.asarray(which)[:, None], [0, 2, 1], [0, 1, 2])
        return replace(
            self,
            faces=np.take_along_axis(self.faces, order, axis=1),
            corners=np.take_along_axis(self.corners, order, axis=1),
        )

    def extended(self, faces: Array, corners: Array) -> Surface:
        """With more faces at the end."""
        return replace(self, faces=np.concatenate([self.faces, faces]), corners=np.concatenate([self.corners, corners]))

    def compact(self) -> tuple[Surface, int]:
        """Without unreferenced vertices, and how many there were."""
        used = np.zeros(len(self.positions), bool)
        used[self.faces] = True
        number = np.cumsum(used) - 1
        return Surface(self.positions[used], number[self.faces], self.corners), int(len(used) - used.sum())


def doubles(positions: Array) -> F8:
    """(v, 3) f8 copy of stored positions: sums and products of them are taken in doubles."""
    return np.asarray(positions, np.float64)
