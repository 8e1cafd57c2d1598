"""Where the light of a picture comes from."""

from __future__ import annotations

import math
from collections.abc import Sequence

from service.render.state import FrameState

DEFAULT_LIGHT = (0.5, 0.7, 1.0)
"""Camera space: to the right, above and behind the eye."""


def light_of(frame: FrameState) -> tuple[float, float, float]:
    """Unit vector towards the light, along the axes that normals have in the end; zero for light from nowhere."""
    x, y, z = _unit(frame.request.shading.light or DEFAULT_LIGHT)
    right, up, backward = frame.view.view[:3].tolist()
    return (
        right[0] * x + up[0] * y + backward[0] * z,
        right[1] * x + up[1] * y + backward[1] * z,
        right[2] * x + up[2] * y + backward[2] * z,
    )


def _unit(vector: Sequence[float]) -> tuple[float, float, float]:
    """A unit vector, for vectors of any length; zero stays zero."""
    largest = max(abs(vector[0]), abs(vector[1]), abs(vector[2]))
    if largest == 0.0:
        return 0.0, 0.0, 0.0
    x, y, z = vector[0] / largest, vector[1] / largest, vector[2] / largest
    length = math.sqrt(x * x + y * y + z * z)
    return x / length, y / length, z / length
