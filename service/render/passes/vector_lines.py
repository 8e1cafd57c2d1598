"""The exact visible lines of the view as strokes (`service.silhouette.strokes`), found once a frame and without the GL."""

from __future__ import annotations

from schemas.lines import LineKind, Stroke
from schemas.render import ProjectTo, SilhouetteRequest
from service.render.line_plan import DRAWN_KINDS, reach_px
from service.render.state import FrameState
from service.silhouette.strokes import stroked_lines

SIMPLIFIED_PX, ROUNDED_PX = 0.5, 0.5
"""A silhouette's jags are those of the mesh: points so near to the line without them are left out, and corners rounded so far."""


def find_vector_lines(frame: FrameState) -> None:
    """Find `frame.vector_lines`. Raises CapabilityError as `vector_lines` does."""
    lines, view = frame.plan.lines, frame.view
    assert lines is not None
    styles = {kind: getattr(lines, kind) for kind in DRAWN_KINDS}
    wanted = SilhouetteRequest(
        project=ProjectTo(width=view.width, height=view.height),
        kinds=[kind for kind, style in styles.items() if style is not None],
        visible_only=True,
        ridge_deg=lines.ridge_deg,
        valley_deg=lines.valley_deg,
        simplify_px=SIMPLIFIED_PX,
        smooth_px=ROUNDED_PX,
    )
    widths = {kind: 0.0 if styles.get(kind) is None else styles[kind].width for kind in LineKind}
    mesh = frame.asset.line_mesh
    frame.vector_lines = stroked_lines(mesh, view, wanted, lines.stroke or Stroke(), widths, reach_px(lines, view))
