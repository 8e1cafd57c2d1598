"""Coverage of a smooth outline."""

from __future__ import annotations

import math

from schemas.conventions import U1
from service.camera import View
from service.kernels.enclosed import fill_enclosed
from service.silhouette.coverage import coverage_mask
from service.silhouette.smooth import SmoothContours

BESIDE_PX = 2
"""Steps beyond the reach: a pixel each for what is partly covered on either side."""


def smooth_mask(contours: SmoothContours, view: View, mesh_mask: U1) -> U1:
    """(h, w) u1: the covered area of each pixel, like `coverage_mask`; mesh_mask (h, w) u1 is that of the mesh's own outline.

    Unlike a mesh's, the layers of a curved surface can turn over where its contours come close to each other, and leave
    slivers without any. The smooth outline may therefore recede from the mesh's by its reach, and open nothing inside.
    """
    mask = coverage_mask(contours.segments(view), view.width, view.height).mask
    steps = min(math.ceil(contours.reach_px) + BESIDE_PX, view.width + view.height)
    fill_enclosed(mask, mesh_mask, steps)
    return mask
