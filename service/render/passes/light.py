"""Where the light of a picture comes from."""

from __future__ import annotations

import numpy as np

from schemas.conventions import F8
from service.render.state import FrameState

DEFAULT_LIGHT = (0.5, 0.7, 1.0)
"""Camera space: to the right, above and behind the eye."""


def light_of(frame: FrameState) -> F8:
    """(3,) f8 unit, towards the light, along the axes that normals have in the end; zero for light from nowhere."""
    return np.asarray(frame.view.view[:3, :3].T @ _unit(np.array(frame.request.shading.light or DEFAULT_LIGHT)))


def _unit(vector: F8) -> F8:
    """A unit vector, for vectors of any length; zero stays zero."""
    largest = np.abs(vector).max()
    if largest == 0.0:
        return vector
    scaled = vector / largest
    return np.asarray(scaled / np.linalg.norm(scaled))
