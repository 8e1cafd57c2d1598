"""The clipped hull in the image, drawn on the CPU without the GL.

A software GL spends more on a fragment of the hull than all of this does on a pixel, and neither needs to be cleared, waited
for or read back. The colour of a pixel is worked out once, and only where the silhouette covers it.
"""

from __future__ import annotations

import numpy as np

from service.kernels.hull_bands import place_hull as place
from service.render.hull_cache import PlacedHull
from service.render.state import FrameState


def place_hull(frame: FrameState) -> None:
    """Find where the hull's vertices, its front faces and its outline are in the image: `frame.placed`."""
    plan, scratch, view = frame.plan, frame.gpu.scratch, frame.view
    s = frame.gpu.hulls.get(frame.asset, plan.hull or 0, plan.halvings)
    faces, edges = len(s.faces), len(s.edge_faces)
    points, front = scratch.array("points", (len(s.positions), 4), np.float64), scratch.array("front", (faces,), np.bool_)
    seen, rows = scratch.array("seen", (faces,), np.int32), scratch.array("rows", (faces, 2), np.int32)
    ends, places = scratch.array("ends", (edges, 4), np.float64), scratch.array("places", (edges, 4), np.float64)
    sense, top = -1.0 if view.mirrored else 1.0, frame.area.y
    surface = (s.positions, s.faces, s.uv, s.edge_vertices, s.edge_faces)
    shown, around = place(view.pixels, surface, sense, top, top + frame.area.height, points, front, seen, rows, ends, places)
    frame.placed = PlacedHull(s, points, sense, seen[:shown], rows[:shown], ends[:around], places[:around])
