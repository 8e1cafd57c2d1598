"""Seconds and memory of every preprocessing stage of one mesh.

    python -m benchmarks.preprocess MESH [--hull-faces 1000] [--texels 1024] [--json]

MESH is a file or a name that `benchmarks.models` knows. Every stage runs in a process of its own, as in the
workers, that has first run it on a small mesh: kernels are warm. `peak_mib` is what that process had resident at most,
interpreter and libraries included. `two_core_seconds` is the time of hull -> bake and of the tree side by side.
"""

from __future__ import annotations

import multiprocessing
import resource
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from threading import BrokenBarrierError
from typing import Any

import numpy as np

from benchmarks.models import mesh_file
from benchmarks.report import mesh_parser, report
from client.shapes import torus_knot, write_ply
from schemas.mesh import DEFAULT_HULL_FACES, DEFAULT_TEXELS, PreprocessOptions

SPAWN = multiprocessing.get_context("spawn")
Values = dict[str, Any]


class Workplace:
    """A folder with the arrays that stages hand on, and the options."""

    def __init__(self, folder: Path, mesh: Path, hull_faces: int, texels: int) -> None:
        self.folder, self.mesh, self.hull_faces, self.texels = folder, mesh, hull_faces, texels

    def put(self, name: str, arrays: Values) -> None:
        """Hand on the arrays of an artifact."""
        with (self.folder / f"{name}.npz").open("wb") as file:
            np.savez(file, **arrays)

    def get(self, name: str) -> Values:
        """The arrays of an artifact."""
        with np.load(self.folder / f"{name}.npz") as stored:
            return dict(stored)


def silent(_: float) -> None:
    return None


def load(at: Workplace) -> Values:
    from worker.load import load_mesh

    loaded = load_mesh(at.mesh, at.mesh.suffix, PreprocessOptions())
    if loaded.edges is None:
        raise SystemExit(f"this mesh has no hull: {loaded.clip.reason}")
    edges = {"edge_vertices": loaded.edges.vertices, "edge_faces": loaded.edges.faces}
    at.put("mesh", {"positions": loaded.positions, "faces": loaded.faces, **loaded.shading.tensors(), **edges})
    at.put("appearance", loaded.appearance or {})
    return {"faces": len(loaded.faces)}


def hull(at: Workplace) -> Values:
    from worker.bake import hull_normals
    from worker.hull import build_hull

    mesh = at.get("mesh")
    built = build_hull(mesh["positions"], mesh["faces"], at.hull_faces, silent)
    at.put("hull", {"positions": built.positions, "faces": built.faces, "normals": hull_normals(built.positions, built.faces)})
    return {"hull_faces": len(built.faces), "volume_excess": round(built.volume_excess, 5)}


def bake(at: Workplace) -> Values:
    from worker.bake import bake_maps

    mesh, coarse = at.get("mesh"), at.get("hull")
    original = (mesh["positions"], mesh["faces"], mesh["normals"])
    hull = (coarse["positions"], coarse["faces"], coarse["normals"])
    maps = bake_maps(*hull, *original, at.get("appearance"), at.texels, silent, corner_normals=mesh.get("corner_normals"))
    color = {} if maps.color is None else {"color": maps.color}
    at.put("maps", {"tile_uv": maps.tile_uv, "normal": maps.normal, **color})
    return {"texels": maps.texel_count, "missed_texels": maps.missed}


def tree(at: Workplace) -> Values:
    from worker.tree import build_tree

    mesh = at.get("mesh")
    built = build_tree(mesh["positions"], mesh["faces"], mesh["edge_vertices"], mesh["edge_faces"], silent)
    at.put("tree", built.tensors())
    return {"tree_nodes": len(built.skip)}


def verify(at: Workplace) -> Values:
    from worker.verify import verify_artifacts

    verify_artifacts(*(at.get(name) for name in ("mesh", "hull", "maps", "tree")), silent)
    return {}


STAGES: dict[str, Callable[[Workplace], Values]] = {"load": load, "hull": hull, "bake": bake, "tree": tree, "verify": verify}


def warm(at: Workplace, names: list[str]) -> None:
    """Run stages, and what they need, on a small knot, so that their kernels are compiled and loaded."""
    with tempfile.TemporaryDirectory() as folder:
        mesh = Path(folder) / "small.ply"
        write_ply(str(mesh), *torus_knot(60, 8))
        small = Workplace(Path(folder), mesh, 200, 128)
        last = max(list(STAGES).index(name) for name in names)
        for stage in list(STAGES.values())[: last + 1]:
            stage(small)


def measured(at: Workplace, names: list[str], barrier: Any, results: Any) -> None:
    """In a process of its own: warm up, wait for the others, run the stages, report."""
    try:
        warm(at, names)
    except BaseException:
        barrier.abort()
        raise
    barrier.wait()
    started = time.perf_counter()
    facts: Values = {}
    for name in names:
        facts |= STAGES[name](at)
    seconds = time.perf_counter() - started
    kib = max(resource.getrusage(who).ru_maxrss for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    results.put({"seconds": round(seconds, 3), "peak_mib": round(kib / 1024.0, 1), "facts": facts})


def side_by_side(at: Workplace, *lines: list[str]) -> tuple[float, list[Values]]:
    """Run lines of stages in parallel processes: (wall seconds from when all were warm, their reports)."""
    barrier, results = SPAWN.Barrier(len(lines) + 1), SPAWN.Queue()
    children = [SPAWN.Process(target=measured, args=(at, line, barrier, results)) for line in lines]
    for child in children:
        child.start()
    try:
        barrier.wait(timeout=600.0)
        started = time.perf_counter()
        for child in children:
            child.join()
        wall = time.perf_counter() - started
        if any(child.exitcode for child in children):
            raise SystemExit("a stage failed; its process says why above")
        return wall, [results.get(timeout=10.0) for _ in lines]
    except BrokenBarrierError:
        raise SystemExit("a stage failed on a small mesh; its process says why above") from None
    finally:
        for child in children:
            child.kill()


def run(mesh: str, hull_faces: int, texels: int) -> Values:
    with tempfile.TemporaryDirectory() as folder, mesh_file(mesh) as path:
        at = Workplace(Path(folder), path, hull_faces, texels)
        stages, facts = [], {}
        for name in STAGES:
            _, (report,) = side_by_side(at, [name])
            facts |= report.pop("facts")
            stages.append({"name": name, **report})
        wall, _ = side_by_side(at, ["hull", "bake"], ["tree"])
    return {
        "mesh": Path(mesh).name,
        "faces": facts.pop("faces"),
        "stages": stages,
        "total_seconds": round(sum(stage["seconds"] for stage in stages), 3),
        "peak_mib": max(stage["peak_mib"] for stage in stages),
        "two_core_seconds": round(wall, 3),
        **facts,
    }


def print_table(result: Values) -> None:
    missed = f"{result['missed_texels']} of {result['texels']} texels missed"
    print(f"{result['mesh']}: {result['faces']} faces, hull of {result['hull_faces']}, {missed}")
    for stage in result["stages"]:
        print(f"  {stage['name']:<8}{stage['seconds']:9.2f} s {stage['peak_mib']:9.0f} MiB")
    print(f"  {'total':<8}{result['total_seconds']:9.2f} s {result['peak_mib']:9.0f} MiB")
    print(f"  hull -> bake beside tree, two processes: {result['two_core_seconds']:.2f} s")


def main() -> None:
    parser = mesh_parser(__doc__ or "")
    parser.add_argument("--hull-faces", type=int, default=DEFAULT_HULL_FACES)
    parser.add_argument("--texels", type=int, default=DEFAULT_TEXELS)
    options = parser.parse_args()
    report(lambda: run(options.mesh, options.hull_faces, options.texels), options.json, print_table)


if __name__ == "__main__":
    main()
