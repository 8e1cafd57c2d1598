"""Views from all round."""

from __future__ import annotations

import math

from schemas.render import Orbit, OrbitCamera

GOLDEN_DEG = 137.50776405003785


def spread_view(view: int, views: int) -> OrbitCamera:
    """One of `views` fitted cameras spread evenly over the sphere of directions (a golden-angle spiral)."""
    elevation = math.degrees(math.asin(1.0 - 2.0 * (view + 0.5) / views))
    return OrbitCamera(orbit=Orbit(azimuth_deg=(view * GOLDEN_DEG) % 360.0, elevation_deg=elevation))
