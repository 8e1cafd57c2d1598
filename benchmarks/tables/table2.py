"""Table 2 of Silhouette Clipping: what silhouette extraction tests and how long it takes, beside brute force and rivals.

    python -m benchmarks.tables.table2 [MESH ...] [--quick] [--json] [--out DIR]

One thread, perspective eyes between 1.5 and 4 radii from the centre; medians over the eyes. All in one process a mesh.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from benchmarks import extraction
from benchmarks.paper import MACHINE, NAMES, TABLE_2
from benchmarks.report import NONE, Result, markdown_table, number, ratio, times
from benchmarks.rivals import AbsentRivalError, numpy_extractor, vtk_extractor
from benchmarks.tables.making import Table, main
from geometry.silhouettes import face_planes, silhouette_simd

MESHES = ("bunny_closed", "dragon_400k", "dragon_871k", "armadillo_86k", "knot", "holes3")
EYES, RIVAL_EYES = 200, 20


def measure(mesh: str, quick: bool) -> Result:
    """The row of `benchmarks.extraction`, and the rivals' microseconds."""
    eyes = 10 if quick else EYES
    return {"eyes": eyes} | extraction.measure(mesh, eyes) | rivals(mesh, 3 if quick else RIVAL_EYES)


def rivals(mesh: str, count: int) -> Result:
    """numpy_us, vtk_us, and for how many eyes each differs from the exact silhouette; vtk_absent where it is."""
    positions, faces, edges = extraction.read(mesh)
    eyes = extraction.random_eyes(count, 0)
    planes = face_planes(positions, faces)
    exact = [silhouette_simd(planes, positions, faces, edges.vertices, edges.faces, eye) for eye in eyes]
    by_numpy = numpy_extractor(positions, faces, edges.vertices, edges.faces)
    wrong = sum(not extraction.same_edges(by_numpy(eye), found) for eye, found in zip(eyes, exact, strict=True))
    result: Result = {"numpy_us": round(extraction.microseconds(by_numpy, eyes), 1), "numpy_mismatches": wrong, "rival_eyes": count}
    try:
        by_vtk = vtk_extractor(positions, faces)
    except AbsentRivalError as absent:
        return result | {"vtk_us": None, "vtk_absent": str(absent)}
    wrong = int(np.sum([by_vtk(eye) != len(found) for eye, found in zip(eyes, exact, strict=True)]))
    return result | {"vtk_us": round(extraction.microseconds(by_vtk, eyes), 1), "vtk_mismatches": wrong}


def text(result: Result) -> str:
    """Times, and counts beside the paper's, models as columns."""
    meshes = result["meshes"]
    names = [name for name in meshes if name in NAMES]
    ours = markdown_table(["one thread, microseconds", *meshes], [[title, *map(cell, meshes.values())] for title, cell in ROWS.items()])
    counted = [[title, *(_beside(meshes[name], name, *keys) for name in names)] for title, keys in COUNTS.items()]
    paper = [[title, *(cell(TABLE_2[NAMES[name]]) for name in names)] for title, cell in PAPER_ROWS.items()]
    absent = sorted({row["vtk_absent"] for row in meshes.values() if "vtk_absent" in row})
    parts = [EXPLAINED.format(eyes=next(iter(meshes.values()))["eyes"]), ours, *(f"No VTK here: {word}." for word in absent)]
    if names:
        parts += [FOREST, markdown_table(["ours / the paper's", *names], counted)]
        parts += ["The paper's times.", markdown_table([f"{MACHINE}, milliseconds", *names], paper)]
    return "\n\n".join(parts)


def _beside(row: Result, name: str, key: str, theirs: str) -> str:
    return f"{number(row[key])} / {number(TABLE_2[NAMES[name]][theirs])}"


EXPLAINED = """\
Medians over {eyes} eyes. Scalar brute force tests every edge with two stored planes; SIMD brute force makes facing bits of all
faces, then scans the edges; the tree is what the service walks. The rivals have the mesh before the clock starts: a few lines of
numpy, and `vtkPolyDataSilhouette` with an eye, its feature edges off. A mismatch is an eye whose edges differ from what the exact
predicate gives; of VTK only their number is compared."""
FOREST = """\
What a walk of the forest tests that is built as in section 5, before it is packed into wide nodes. Eyes are ours, so silhouettes
differ in length."""

ROWS: dict[str, Callable[[Result], str]] = {
    "faces": lambda row: number(row["faces"]),
    "edges": lambda row: number(row["edges"]),
    "silhouette edges": lambda row: number(row["silhouette_edges"]),
    "**tree**": lambda row: number(row["tree_us"]),
    "brute force, scalar": lambda row: number(row["brute_scalar_us"]),
    "brute force, SIMD": lambda row: number(row["brute_simd_us"]),
    "numpy": lambda row: number(row["numpy_us"]),
    "VTK": lambda row: number(row["vtk_us"]),
    "scalar / tree": lambda row: times(ratio(row["brute_scalar_us"], row["tree_us"])),
    "**SIMD / tree**": lambda row: times(ratio(row["brute_simd_us"], row["tree_us"])),
    "numpy / tree": lambda row: times(ratio(row["numpy_us"], row["tree_us"])),
    "VTK / tree": lambda row: times(ratio(row["vtk_us"], row["tree_us"])),
    "mismatches: tree, SIMD": lambda row: number(row["mismatches"]),
    "mismatches: numpy": lambda row: f"{row['numpy_mismatches']} of {row['rival_eyes']}",
    "mismatches: VTK": lambda row: f"{row['vtk_mismatches']} of {row['rival_eyes']}" if "vtk_mismatches" in row else NONE,
    "seconds to build the tree": lambda row: number(row["build_seconds"]),
}
COUNTS = {
    "silhouette edges": ("silhouette_edges", "silhouette_edges"),
    "tested edges": ("stored_edges", "tested_edges"),
    "tested nodes": ("stored_nodes", "tested_nodes"),
}
PAPER_ROWS: dict[str, Callable[[dict[str, float]], str]] = {
    "search tree": lambda row: number(row["tree"]),
    "brute force, scalar": lambda row: number(row["brute_force"]),
    "brute force / tree": lambda row: times(row["speed_up"]),
}


def plot(result: Result, folder: Path) -> list[str]:
    """Times as bars."""
    from benchmarks.tables.plots import bars

    kinds = {"VTK": "vtk_us", "numpy": "numpy_us", "brute force, scalar": "brute_scalar_us", "brute force, SIMD": "brute_simd_us"}
    series = {label: [row[key] for row in result["meshes"].values()] for label, key in (kinds | {"tree": "tree_us"}).items()}
    bars(folder / "table2.png", list(result["meshes"]), series, "silhouette of an eye, µs (log scale)")
    return ["table2.png"]


TABLE = Table("table2", "Table 2: silhouette extraction", MESHES, measure, text, plot)

if __name__ == "__main__":
    main(TABLE)
