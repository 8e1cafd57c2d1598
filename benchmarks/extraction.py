"""Silhouette extraction by the search tree against brute force, on one thread, and by the tree on more.

    python -m benchmarks.extraction MESH [--eyes 200] [--json]

MESH is a file or a name that `benchmarks.models` knows. Eyes are perspective, in random directions, between 1.5
and 4 radii from the centre; figures are medians over them. `brute_scalar_us` tests both stored planes of every edge, one edge
at a time; `brute_simd_us` is SIMD facing bits, then a scan of the edges. `tested_edges` and `tested_nodes` are what
`tree_us` tests, up to 64 at a time; `scalar_speedup` and `simd_speedup` are brute force over that. `many_us` is an eye's share
of one call for all of them, `many_threads_us` that of the same call on THREADS threads, and `threads_us` is one eye on them.
`stored_edges` and `stored_nodes` are what a walk of the stored forest would test one at a time, as in the paper. `mismatches`
counts eyes for which the tree or the SIMD brute force differ from the exact predicate on all edges; as many orthographic eyes
as a tenth of `--eyes` are checked too.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numba import njit

from benchmarks.models import mesh_file
from benchmarks.report import mesh_parser, report
from client.shapes import torus_knot
from geometry.silhouettes import FacePlanes, face_planes, silhouette_edgewise, silhouette_scalar, silhouette_simd
from geometry.topology import EdgeTable, build_edges
from schemas.conventions import F4, F8, I4, Frame
from schemas.mesh import PreprocessOptions
from service.silhouette.extract import SilhouetteTree
from worker.load import load_mesh
from worker.tree import Tree, build_tree

NEAREST, FARTHEST = 1.5, 4.0  # radii
ROUNDS = 3  # timings of an eye; the least counts
THREADS = 2


def read(mesh: str) -> tuple[F4, I4, EdgeTable]:
    """Positions in the normalised frame, faces, edges."""
    with mesh_file(mesh) as path:
        loaded = load_mesh(path, path.suffix, PreprocessOptions())
    if loaded.edges is None:
        raise SystemExit(f"this mesh has no silhouette tree: {loaded.clip.reason}")
    return loaded.positions, loaded.faces, loaded.edges


def silent(_: float) -> None:
    return None


def random_eyes(count: int, at_infinity: int) -> F8:
    rng = np.random.default_rng(0)
    direction = rng.normal(size=(count + at_infinity, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    w = np.concatenate([np.ones(count), np.zeros(at_infinity)])
    distance = np.where(w > 0, rng.uniform(NEAREST, FARTHEST, len(w)), 1.0)
    return np.column_stack([direction * distance[:, None], w])


def microseconds(run: Callable[[F8], Any], eyes: F8) -> float:
    """Median over the eyes of the least of ROUNDS runs."""
    best = np.full(len(eyes), np.inf)
    for _ in range(ROUNDS):
        for i, eye in enumerate(eyes):
            start = time.perf_counter()
            run(eye)
            best[i] = min(best[i], time.perf_counter() - start)
    return float(np.median(best) * 1e6)


def together(tree: SilhouetteTree, eyes: F8, threads: int) -> float:
    """Microseconds an eye of one call for all eyes, the least of ROUNDS."""
    tree.extract_many(eyes[:threads], threads)
    least = np.inf
    for _ in range(ROUNDS):
        start = time.perf_counter()
        tree.extract_many(eyes, threads)
        least = min(least, time.perf_counter() - start)
    return float(least / len(eyes) * 1e6)


@njit(cache=True)
def stored_walk(scaled, front, back, separation, skip, edge_start, eye):  # noqa: ANN001, ANN201
    """(nodes, edges) that the paper's walk of the stored forest tests for a perspective eye."""
    nodes, edges, i = 0, 0, 0
    while i < len(skip):
        nodes += 1
        along, to_front, to_back = 0.0, 0.0, 0.0
        for k in range(3):
            along += scaled[i, k] * (eye[k] - front[i, k])
            to_front += (eye[k] - front[i, k]) ** 2
            to_back += (eye[k] - back[i, k]) ** 2
        behind = -along - separation[i]
        if (along >= 0.0 and along * along > to_front) or (behind >= 0.0 and behind * behind > to_back):
            i = skip[i]
        else:
            edges += edge_start[i + 1] - edge_start[i]
            i += 1
    return nodes, edges


def same_edges(a: I4, b: I4) -> bool:
    return np.array_equal(a[np.lexsort(a.T)], b[np.lexsort(b.T)])


def compile_kernels() -> None:
    vertices, faces = torus_knot(40, 6)
    edges = build_edges(faces)
    build_tree(Frame.around(vertices).to_normalised(vertices).astype(np.float32), faces, edges.vertices, edges.faces, silent)


def measure(name: str, eye_count: int) -> dict[str, Any]:
    compile_kernels()
    positions, faces, edges = read(name)
    start = time.perf_counter()
    stored = build_tree(positions, faces, edges.vertices, edges.faces, silent)
    build_seconds = time.perf_counter() - start
    mesh = {"positions": positions, "faces": faces, "edge_vertices": edges.vertices, "edge_faces": edges.faces}
    tree = SilhouetteTree(mesh, stored.tensors())
    planes = face_planes(positions, faces)
    table = (positions, faces, edges.vertices, edges.faces)

    eyes = random_eyes(eye_count, eye_count // 10)
    near = eyes[:eye_count]
    counts = np.median([_counts(tree, stored, eye) for eye in near], axis=0)
    scalar = microseconds(lambda eye: silhouette_edgewise(planes, *table, eye), near)
    simd = microseconds(lambda eye: silhouette_simd(planes, *table, eye), near)
    alone = microseconds(tree.extract, near)
    return {
        "mesh": Path(name).name,
        "faces": len(faces),
        "edges": len(edges.vertices),
        "silhouette_edges": int(counts[0]),
        "tested_edges": int(counts[1]),
        "tested_nodes": int(counts[2]),
        "stored_edges": int(counts[3]),
        "stored_nodes": int(counts[4]),
        "brute_scalar_us": round(scalar, 1),
        "brute_simd_us": round(simd, 1),
        "tree_us": round(alone, 1),
        "scalar_speedup": round(scalar / alone, 2),
        "simd_speedup": round(simd / alone, 2),
        "many_us": round(together(tree, near, 1), 1),
        "many_threads_us": round(together(tree, near, THREADS), 1),
        "threads_us": round(microseconds(lambda eye: tree.extract(eye, THREADS), near), 1),
        "mismatches": sum(not _agree(tree, planes, eye) for eye in eyes),
        "build_seconds": round(build_seconds, 2),
    }


def _agree(tree: SilhouetteTree, planes: FacePlanes, eye: F8) -> bool:
    table = (tree.positions, tree.faces, tree.edge_vertices, tree.edge_faces, eye)
    exact = silhouette_scalar(*table)
    return same_edges(tree.extract(eye).edges, exact) and same_edges(silhouette_simd(planes, *table), exact)


def _counts(tree: SilhouetteTree, stored: Tree, eye: F8) -> tuple[int, ...]:
    found = tree.extract(eye)
    cones = (stored.scaled_normal, stored.front_anchor, stored.back_anchor, stored.separation)
    nodes, edges = stored_walk(*cones, stored.skip, stored.edge_start, eye)
    return len(found.edges), found.tested_edges, found.tested_nodes, edges, nodes


def print_table(row: dict[str, Any]) -> None:
    for key, value in row.items():
        print(f"{key:>18}  {value}")


def main() -> None:
    parser = mesh_parser(__doc__ or "")
    parser.add_argument("--eyes", type=int, default=200)
    arguments = parser.parse_args()
    report(lambda: measure(arguments.mesh, arguments.eyes), arguments.json, print_table)


if __name__ == "__main__":
    main()
