"""Depth that tells near from far at any distance: floats, and reversed.

Image Precision Silhouette Edges, section 3.2, warns of the depth buffer's uneven steps. Depth here is near / w in a perspective view,
which a float holds to 2^-24 of the distance wherever it is, so that the near plane may be as near as one likes; in an orthographic view
it is linear.
"""

from __future__ import annotations

import numpy as np

from schemas.conventions import F8
from service.camera import View

DEPTH_STEPS, COARSEST_PX = 2.0**24, 0.1
"""Steps of the usual depth, and pixels' sizes of it at the far end that one of them may be."""
NEAREST_PART = 1e-7
"""Of the farthest depth: nearer than that, depth is no longer told apart."""


def depth_row(view: View) -> F8:
    """(4,) f8: row of the clip matrix whose quotient with w is 1 at the near plane and falls to 0 at the far one."""
    if view.orthographic:
        return np.asarray(0.5 * (view.matrix[3] - view.matrix[2]))
    return np.array([0.0, 0.0, 0.0, view.far * NEAREST_PART])


def is_too_far(view: View) -> bool:
    """Whether 24 bits of depth may not tell apart what is COARSEST_PX pixels apart in depth, at the far end of the view."""
    return not view.orthographic and view.far * view.depth_pixels > COARSEST_PX * DEPTH_STEPS * view.near


def pixel_depth(view: View) -> tuple[float, float]:
    """(share, shift): depth d comes to d (1 + share) + shift when it is nearer by as much as a pixel covers."""
    if view.orthographic:
        return 0.0, 1.0 / (view.depth_pixels * (view.far - view.near))
    return 1.0 / view.depth_pixels, 0.0
