"""Excess volume of enclosing hulls made by offsetting and simplifying, beside ours.

    python -m benchmarks.offset_hull MESH [--faces 500,1000,4000] [--grid 128] [--json]

Based on: Wang et al., "Silhouette Texture" (EGSR 2006), section 3: a surface at some distance from the mesh, simplified by
quadrics to the faces asked for, the least distance being looked for at which the result still encloses the mesh. The distance
field is sampled on a grid and contoured by marching cubes (libigl), the simplification is fast-simplification's. Enclosure is asked
of the winding number at all vertices of the original and at random points of its faces. What the rival loses to the grid counts
against it: a finer one (--grid) rounds sharp edges less.
"""

from __future__ import annotations

import importlib
import time
from typing import Any

import numpy as np

from benchmarks.hull import SAMPLES, silent, warm_up
from benchmarks.models import AbsentError, mesh_file
from benchmarks.report import mesh_parser, number, report
from benchmarks.rivals import simplified
from geometry.topology import NotManifoldError, build_edges, signed_volume
from schemas.conventions import F4, F8, I4
from schemas.mesh import PreprocessOptions
from tests.oracles_hull import points_outside, surface_points
from worker.hull import build_hull
from worker.load import load_mesh

LEAST, MOST = 5e-4, 0.3
"""Distances between which is looked, normalised units."""
HALVINGS = 9
"""Of the ratio of the two: the distance is found within 1.3 %."""
BORDER = 1.05
"""Half the side of the grid beyond the largest distance."""


class DistanceField:
    """Signed distances from a mesh on a grid. positions (v, 3) f4, faces (f, 3) i4; grid: points along each axis."""

    def __init__(self, positions: F4, faces: I4, grid: int) -> None:
        try:
            self._igl = importlib.import_module("igl")
        except ImportError as error:
            raise AbsentError("libigl is not installed") from error
        self._grid = grid
        axis = np.linspace(-BORDER - MOST, BORDER + MOST, grid)
        z, y, x = np.meshgrid(axis, axis, axis, indexing="ij")
        self._points = np.column_stack([x.ravel(), y.ravel(), z.ravel()])
        kind = self._igl.SignedDistanceType.SIGNED_DISTANCE_TYPE_FAST_WINDING_NUMBER
        self._distance, *_ = self._igl.signed_distance(self._points, positions.astype(np.float64), faces.astype(np.int64), kind)

    def surface(self, distance: float) -> tuple[F4, I4]:
        """The surface at a distance, outward. Returns (positions (n, 3) f4, faces (m, 3) i4)."""
        made, triangles, *_ = self._igl.marching_cubes(self._distance, self._points, *[self._grid] * 3, distance)
        positions, faces = np.ascontiguousarray(made, np.float32), np.ascontiguousarray(triangles, np.int32)
        return positions, faces if signed_volume(positions, faces) > 0.0 else np.ascontiguousarray(faces[:, ::-1])


def offset_hull(field: DistanceField, points: F8, max_faces: int) -> tuple[float, F4, I4] | None:
    """(distance, positions, faces) of the enclosing hull at the least distance; None where none encloses.

    points: (n, 3) f8 of the original that must lie inside or on it.
    """
    low, high, best = LEAST, MOST, None
    for _ in range(HALVINGS):
        distance = float(np.sqrt(low * high))
        hull = simplified(*field.surface(distance), max_faces)
        if _encloses(hull, points):
            high, best = distance, (distance, *hull)
        else:
            low = distance
    return best


def _encloses(hull: tuple[F4, I4], points: F8) -> bool:
    try:
        build_edges(hull[1])
    except NotManifoldError:
        return False
    return not any(points_outside(*hull, some).any() for some in (points[::40], points))


def run(name: str, counts: list[int], grid: int) -> dict[str, Any]:
    with mesh_file(name) as path:
        mesh = load_mesh(path, path.suffix, PreprocessOptions())
    surface, volume = (mesh.positions, mesh.faces), signed_volume(mesh.positions, mesh.faces)
    points = np.concatenate([mesh.positions, surface_points(*surface, SAMPLES)])
    start = time.perf_counter()
    field = DistanceField(*surface, grid)
    rows = []
    for count in counts:
        ours = build_hull(*surface, count, silent)
        theirs = offset_hull(field, points, count)
        row = {"faces": count, "ours": ours.volume_excess, "ours_faces": len(ours.faces), "offset": None, "offset_faces": None}
        if theirs is not None:
            distance, positions, faces = theirs
            excess = signed_volume(positions, faces) / volume - 1.0
            row |= {"offset": excess, "offset_faces": len(faces), "distance": distance}
        rows.append(row)
    return {"mesh": name, "grid": grid, "seconds": round(time.perf_counter() - start, 1), "hulls": rows}


def print_table(result: dict[str, Any]) -> None:
    print(f"{result['mesh']}, distances on a grid of {result['grid']}^3")
    print(f"{'faces':>6} {'ours %':>8} {'offset %':>9} {'its faces':>10} {'distance':>9}")
    for row in result["hulls"]:
        ours, offset = 100.0 * row["ours"], None if row["offset"] is None else 100.0 * row["offset"]
        print(f"{row['faces']:>6} {ours:>8.3f} {number(offset):>9} {row['offset_faces'] or 0:>10} {number(row.get('distance')):>9}")


def main() -> None:
    parser = mesh_parser(__doc__ or "")
    parser.add_argument("--faces", default="500,1000,4000", help="face counts, separated by commas")
    parser.add_argument("--grid", type=int, default=128, help="points along each axis")
    arguments = parser.parse_args()
    warm_up()
    counts = [int(count) for count in arguments.faces.split(",")]
    report(lambda: run(arguments.mesh, counts, arguments.grid), arguments.json, print_table)


if __name__ == "__main__":
    main()
