"""Preprocessing: seconds and memory of every stage, and of all of it on two cores.

    python -m benchmarks.tables.preprocessing [MESH ...] [--quick] [--json] [--out DIR]

The paper gives 30 minutes to 5 hours, by complexity of the model.
"""

from __future__ import annotations

from benchmarks import preprocess
from benchmarks.report import Result, markdown_table, number
from benchmarks.tables.making import Table, main
from schemas.mesh import DEFAULT_HULL_FACES, DEFAULT_TEXELS

MESHES = ("bunny_closed", "dragon_400k", "dragon_871k")
QUICK_HULL_FACES, QUICK_TEXELS = 200, 128


def measure(mesh: str, quick: bool) -> Result:
    """What `benchmarks.preprocess` says."""
    return preprocess.run(mesh, *((QUICK_HULL_FACES, QUICK_TEXELS) if quick else (DEFAULT_HULL_FACES, DEFAULT_TEXELS)))


def text(result: Result) -> str:
    """A row for each mesh, a column for each stage."""
    meshes = result["meshes"]
    stages = list(dict.fromkeys(stage["name"] for row in meshes.values() for stage in row["stages"]))
    rows = []
    for name, row in meshes.items():
        seconds = {stage["name"]: stage["seconds"] for stage in row["stages"]}
        cells = [number(seconds.get(stage)) for stage in stages]
        rows.append(
            [name, number(row["faces"]), *cells, number(row["total_seconds"]), number(row["two_core_seconds"]), number(row["peak_mib"])]
        )
    head = ["seconds", "faces", *stages, "sum", "on two cores", "peak, MiB"]
    return f"Kernels warm, each stage in a process of its own. The paper: 30 minutes to 5 hours.\n\n{markdown_table(head, rows)}"


TABLE = Table("preprocessing", "Preprocessing", MESHES, measure, text)

if __name__ == "__main__":
    main(TABLE)
