"""Conventions every part agrees on.

- Right-handed coordinates; faces are counter-clockwise seen from outside; cameras look down -z of their frame, y is up in
  the image, image row 0 is the top row. Degrees at the API, radians inside. Colour is sRGB with straight alpha at the
  boundary, linear and premultiplied inside.
- All geometry is stored in a *normalised frame*: the bounding sphere of the mesh becomes the unit sphere at the origin.
- An eye is homogeneous, ``(4,) f8`` in the normalised frame: ``(x, y, z, 1)`` for a perspective eye, ``(dx, dy, dz, 0)``
  with a unit direction *towards the viewer* for an orthographic one.
- Facing rule: face f is front-facing for eye p when ``det[v1 - v0, v2 - v0, p - w v0] >= 0`` (w the eye's fourth
  coordinate), decided exactly; the tie counts as front-facing. A directed edge is on the silhouette when its left face is
  front-facing and its right face is not. Only ``geometry.predicates`` decides this.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.generic]
F8 = npt.NDArray[np.float64]
F4 = npt.NDArray[np.float32]
I4 = npt.NDArray[np.int32]
U1 = npt.NDArray[np.uint8]


@dataclass(frozen=True)
class Frame:
    """The normalised frame of a mesh: ``model = centre + scale * normalised``, all in float64.

    centre: (3,) model units. scale: model units for one normalised unit, > 0.
    """

    centre: tuple[float, float, float]
    scale: float

    @classmethod
    def around(cls, points: Array) -> Frame:
        """Frame of (n, 3) points in model units: centre of the bounding box, radius to the farthest point.

        Raises ValueError when the points are none, not finite, or all the same.
        """
        p = np.asarray(points, np.float64)
        if not len(p) or not np.all(np.isfinite(p)):
            raise ValueError("a frame needs finite points")
        low, high = p.min(axis=0), p.max(axis=0)
        centre = low / 2.0 + high / 2.0
        offset = p - centre
        largest = float(np.abs(offset).max())
        if largest == 0.0:
            raise ValueError("all points are the same")
        squares = (offset / largest) ** 2
        sums = squares.sum(axis=1)
        # of the farthest points, summed in order of size: the same to the bit however the axes are turned
        farthest = np.sort(squares[sums >= sums.max() * (1.0 - 1e-14)], axis=1).sum(axis=1).max()
        scale = largest * float(np.sqrt(farthest))
        return cls((float(centre[0]), float(centre[1]), float(centre[2])), scale)

    def to_model(self, points: Array) -> F8:
        """(..., 3) normalised -> (..., 3) f8 model units."""
        return np.asarray(points, np.float64) * self.scale + np.asarray(self.centre)

    def to_normalised(self, points: Array) -> F8:
        """(..., 3) model units -> (..., 3) f8 normalised."""
        return (np.asarray(points, np.float64) - np.asarray(self.centre)) / self.scale
