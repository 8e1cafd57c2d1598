"""Seconds, tightness and enclosure of progressive hulls of one mesh.

    python -m benchmarks.hull MESH --faces 500,1000 --out DIR [--json]

MESH is a file or a name that `benchmarks.models` knows. Kernels are warm. `seconds` is the median time of making
the hull, the whole sequence included; `volume_excess` is relative to the original's volume; `enclosed` says that every vertex of
the original that bounds interior, and random such points of its faces, have a winding number of at least 1 in the hull or are
on its surface. DIR/hull_<faces_requested>.ply has the hull in the original's coordinates.
"""

from __future__ import annotations

import statistics
import time
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.models import mesh_file
from benchmarks.report import mesh_parser, report
from client.shapes import torus_knot
from schemas.conventions import F4, I4, Frame
from schemas.mesh import PreprocessOptions
from tests.oracles_hull import surface_points, uncovered
from worker.hull import Hull, build_hull
from worker.load import LoadedMesh, load_mesh

SAMPLES = 10_000
ROUNDS, ENOUGH_S = 5, 20.0
"""Rounds of a median, fewer when they take longer than this altogether."""


def silent(_: float) -> None:
    return None


def warm_up() -> None:
    """Compile the kernels on a small knot."""
    vertices, faces = torus_knot(60, 8)
    build_hull(Frame.around(vertices).to_normalised(vertices).astype(np.float32), faces, 100, silent)


def write_double_ply(path: Path, frame: Frame, positions: F4, faces: I4) -> None:
    """Binary PLY with float64 vertices: the original's coordinates may be far from the origin."""
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {len(positions)}"]
    header += [f"property double {axis}" for axis in "xyz"]
    header += [f"element face {len(faces)}", "property list uchar int vertex_indices", "end_header", ""]
    rows = np.empty(len(faces), np.dtype([("n", "u1"), ("v", "<i4", 3)]))
    rows["n"], rows["v"] = 3, faces
    path.write_bytes("\n".join(header).encode() + frame.to_model(positions).astype("<f8").tobytes() + rows.tobytes())


def timed_hull(mesh: LoadedMesh, max_faces: int) -> tuple[Hull, float]:
    """The hull and the median of its seconds."""
    seconds: list[float] = []
    while len(seconds) < ROUNDS and sum(seconds) < ENOUGH_S:
        start = time.perf_counter()
        hull = build_hull(mesh.positions, mesh.faces, max_faces, silent)
        seconds.append(time.perf_counter() - start)
    return hull, statistics.median(seconds)


def measure(mesh: LoadedMesh, max_faces: int, out: Path) -> dict[str, Any]:
    hull, seconds = timed_hull(mesh, max_faces)
    write_double_ply(out / f"hull_{max_faces}.ply", mesh.frame, hull.positions, hull.faces)
    points = np.concatenate([mesh.positions, surface_points(mesh.positions, mesh.faces, SAMPLES)])
    return {
        "faces_requested": max_faces,
        "faces": len(hull.faces),
        "seconds": round(seconds, 4),
        "volume_excess": hull.volume_excess,
        "enclosed": not bool(uncovered(mesh.positions, mesh.faces, hull.positions, hull.faces, points).any()),
    }


def run(name: str, counts: list[int], out: Path) -> dict[str, Any]:
    with mesh_file(name) as path:
        mesh = load_mesh(path, path.suffix, PreprocessOptions())
    if not mesh.clip.available:
        raise SystemExit(f"this mesh has no hull: {mesh.clip.reason}")
    out.mkdir(parents=True, exist_ok=True)
    return {
        "mesh": Path(name).name,
        "vertices": len(mesh.positions),
        "faces": len(mesh.faces),
        "hulls": [measure(mesh, count, out) for count in counts],
    }


def print_table(result: dict[str, Any]) -> None:
    print(f"{result['mesh']}: {result['vertices']} vertices, {result['faces']} faces")
    print(f"{'requested':>9} {'faces':>7} {'seconds':>8} {'excess %':>9} enclosed")
    for row in result["hulls"]:
        excess = 100.0 * row["volume_excess"]
        print(f"{row['faces_requested']:>9} {row['faces']:>7} {row['seconds']:>8.3f} {excess:>9.3f} {'yes' if row['enclosed'] else 'NO'}")


def main() -> None:
    parser = mesh_parser(__doc__ or "")
    parser.add_argument("--faces", default="500,1000", help="face counts, separated by commas")
    parser.add_argument("--out", type=Path, required=True, help="folder for the hulls")
    arguments = parser.parse_args()
    counts = [int(count) for count in arguments.faces.split(",")]
    warm_up()
    report(lambda: run(arguments.mesh, counts, arguments.out), arguments.json, print_table)


if __name__ == "__main__":
    main()
