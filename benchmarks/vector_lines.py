"""What vector lines of a mesh take: what is found once a mesh, and kinds, cuts, rays and chains of a view.

    python -m benchmarks.vector_lines MESH [--views 20] [--size 800] [--angle 60] [--stroke] [--json]

All kinds, hidden lines too. Milliseconds of a view are medians over the views, `once_ms` and `crossings_ms` (where faces cross) are what
the first view waits for. `written_ms` is the drawing as SVG. With --stroke lines are simplified and rounded within half a pixel each, and
`styled_ms` is what strokes with widths by depth, opacities by curvature and a wobble take, `styled_written_ms` their drawing.
"""

from __future__ import annotations

import statistics
import time
from typing import Any

import numpy as np

from benchmarks.models import mesh_file
from benchmarks.report import mesh_parser, number, report
from schemas.lines import LineKind, Stroke
from schemas.mesh import PreprocessOptions
from schemas.render import ProjectTo, SilhouetteRequest
from service.camera import View, resolve_camera
from service.measure.views import spread_view
from service.silhouette.line_documents import lines_svg
from service.silhouette.line_mesh import LineMesh
from service.silhouette.lines import VectorLines, vector_lines
from service.silhouette.strokes import depth_range, stylised
from worker.load import LoadedMesh, load_mesh

WARMING = 1
"""Views before the first that is timed: kernels are compiled, or read from the cache, in it."""


STROKE = Stroke(width_by="depth", opacity_by="curvature", wobble_px=2.0)


def request(view: int, views: int, side: int, angle: float, *, stroked: bool) -> SilhouetteRequest:
    """All kinds of lines in one of `views` views."""
    angles: dict[str, Any] = {"ridge_deg": angle, "valley_deg": angle, "crease_deg": angle}
    angles |= {"simplify_px": 0.5, "smooth_px": 0.5} if stroked else {}
    return SilhouetteRequest(
        camera=spread_view(view % views, views), project=ProjectTo(width=side, height=side), kinds=list(LineKind), **angles
    )


def once(loaded: LoadedMesh) -> tuple[LineMesh, float, float]:
    """The mesh made ready, and what that and finding its crossings took, milliseconds; the kernels are compiled before."""
    LineMesh(loaded.positions, loaded.faces[:2]).crossings()
    start = time.perf_counter()
    mesh = LineMesh(loaded.positions, loaded.faces)
    made = time.perf_counter()
    mesh.crossings()
    return mesh, (made - start) * 1e3, (time.perf_counter() - made) * 1e3


def styled(lines: VectorLines, camera: View, mesh: LineMesh) -> dict[str, float]:
    """What making and writing strokes of the lines takes, and how large the drawing is."""
    start = time.perf_counter()
    strokes = stylised(lines, STROKE, depth_range(mesh.positions, camera), np.full(len(LineKind), 3.0))
    ended = time.perf_counter()
    drawing = lines_svg(strokes, camera, {})
    written = time.perf_counter()
    return {"styled_ms": (ended - start) * 1e3, "styled_written_ms": (written - ended) * 1e3, "styled_kib": len(drawing) / 1024}


def measure(name: str, views: int, side: int, angle: float, *, stroked: bool) -> dict[str, Any]:
    """Times and counts of a mesh."""
    with mesh_file(name) as path:
        loaded = load_mesh(path, path.suffix, PreprocessOptions())
    mesh, once_ms, crossings_ms = once(loaded)
    rows: list[dict[str, float]] = []
    for view in range(-WARMING, views):
        wanted = request(view, views, side, angle, stroked=stroked)
        camera = resolve_camera(wanted.camera, loaded.frame, side, side)
        start = time.perf_counter()
        lines = vector_lines(mesh, camera, wanted)
        ended = time.perf_counter()
        lines_svg(lines, camera, {})
        written = time.perf_counter()
        row = {"ms": (ended - start) * 1e3, "written_ms": (written - ended) * 1e3, "polylines": len(lines), "rays": lines.rays}
        row |= styled(lines, camera, mesh) if stroked else {}
        rows.append(row | {f"{step}_ms": ms for step, ms in lines.passes if step != "crossings"})
    medians = {key: round(statistics.median(row[key] for row in rows[WARMING:]), 2) for key in rows[0]}
    found = {"mesh": name, "faces": len(loaded.faces), "crossings": len(mesh.crossings().ends), "views": views, "size": side}
    return found | {"once_ms": round(once_ms, 1), "crossings_ms": round(crossings_ms, 1)} | medians


def table(result: dict[str, Any]) -> None:
    """One line a figure."""
    for key, value in result.items():
        print(f"{key:>14}  {value if isinstance(value, str) else number(value)}")


def main() -> None:
    """The command line."""
    parser = mesh_parser(__doc__ or "")
    parser.add_argument("--views", type=int, default=20)
    parser.add_argument("--size", type=int, default=800, help="pixels")
    parser.add_argument("--angle", type=float, default=60.0, help="degrees, of ridges, valleys and creases")
    parser.add_argument("--stroke", action="store_true", help="strokes of the lines, too")
    given = parser.parse_args()
    report(lambda: measure(given.mesh, given.views, given.size, given.angle, stroked=given.stroke), given.json, table)


if __name__ == "__main__":
    main()
