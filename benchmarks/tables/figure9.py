"""Figure 9 of Silhouette Clipping: time of extraction against the size of the silhouette, over simplified bunnies.

    python -m benchmarks.tables.figure9 [MESH ...] [--quick] [--json] [--out DIR]

The tree's time should grow with the silhouette (m), brute force's with the mesh, which is m squared.
"""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np

from benchmarks import extraction
from benchmarks.models import mesh_file
from benchmarks.paper import BUNNY_FACES
from benchmarks.report import Result, markdown_table, number, times
from benchmarks.rivals import simplified
from benchmarks.tables.making import Table, main
from client.shapes import write_ply

EYES = 200
CURVES = {"brute force, scalar": "brute_scalar_us", "brute force, SIMD": "brute_simd_us", "tree": "tree_us"}


def measure(mesh: str, quick: bool) -> Result:
    """{points: rows of `benchmarks.extraction`, coarse to fine, growth: {curve: exponent}}."""
    points = []
    with tempfile.TemporaryDirectory() as folder, mesh_file(mesh) as full:
        positions, faces, _ = extraction.read(str(full))
        for count in BUNNY_FACES:
            if count < len(faces):
                path = Path(folder) / f"{count}.ply"
                write_ply(str(path), *simplified(positions, faces, count))
                points.append(extraction.measure(str(path), 10 if quick else EYES))
        points.append(extraction.measure(str(full), 10 if quick else EYES))
    return {"points": points, "growth": {label: growth(points, key) for label, key in CURVES.items()}}


def growth(points: list[Result], key: str) -> float:
    """The exponent p for which time is closest to silhouette edges ^ p, by least squares of logarithms."""
    logarithms = np.log([[row["silhouette_edges"], row[key]] for row in points])
    return round(float(np.polyfit(logarithms[:, 0], logarithms[:, 1], 1)[0]), 3)


def text(result: Result) -> str:
    """A table and the exponents for each mesh."""
    parts = []
    head = ["faces", "silhouette edges", "scalar, µs", "SIMD, µs", "tree, µs", "scalar / tree", "SIMD / tree", "mismatches"]
    for name, row in result["meshes"].items():
        lines = []
        for point in row["points"]:
            spent = [point[key] for key in CURVES.values()]
            ratios = [times(slow / spent[2]) for slow in spent[:2]]
            counts = [number(point["faces"]), number(point["silhouette_edges"])]
            lines.append([*counts, *map(number, spent), *ratios, number(point["mismatches"])])
        grows = ", ".join(f"{label} {exponent:.2f}" for label, exponent in row["growth"].items())
        parts += [f"{name}, simplified by quadrics; one thread, medians.", markdown_table(head, lines)]
        parts.append(f"Time grows with the silhouette to the power of: {grows}. The paper: 2 for (scalar) brute force, 1 for its tree.")
    return "\n\n".join(parts)


def plot(result: Result, folder: Path) -> list[str]:
    """Both axes logarithmic, so that powers are slopes."""
    from benchmarks.tables.plots import COLORS, axes, plain_logarithmic, save

    names = []
    for name, row in result["meshes"].items():
        figure, made = axes("edges on the silhouette (median)", "silhouette of an eye, µs")
        edges = [point["silhouette_edges"] for point in row["points"]]
        for (label, key), color in zip(CURVES.items(), (COLORS[1], COLORS[2], COLORS[4]), strict=True):
            legend = f"{label}: power {row['growth'][label]:.2f}"
            made.loglog(edges, [point[key] for point in row["points"]], "o-", color=color, label=legend)
        for point, at in zip(row["points"], edges, strict=True):
            made.annotate(
                f"{point['faces']:,}\nfaces", (at, point["brute_scalar_us"]), (0, 8), textcoords="offset points", ha="center", fontsize=8
            )
        made.margins(x=0.08, y=0.15)
        plain_logarithmic(made.xaxis)
        plain_logarithmic(made.yaxis)
        made.legend(frameon=False)
        names.append("figure9.png" if len(result["meshes"]) == 1 else f"figure9_{name}.png")
        save(figure, folder / names[-1])
    return names


TABLE = Table("figure9", "Figure 9: extraction time against silhouette size", ("bunny_closed",), measure, text, plot)

if __name__ == "__main__":
    main(TABLE)
