"""Figure 11 of Silhouette Clipping: which meshes drawn in full take as long as a clipped hull with a finer silhouette.

    python -m benchmarks.tables.figure11 [MESH ...] [--quick] [--json] [--out DIR]

The mesh is simplified to several resolutions. Of each are measured: its drawing in full, and a hull of 500 faces clipped to its
silhouette. A curve's point (x, y): a hull clipped to the silhouette of x faces takes as long as drawing y faces.
"""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np

from benchmarks import extraction, frame
from benchmarks.models import mesh_file
from benchmarks.report import Result, markdown_table, number
from benchmarks.rivals import simplified
from benchmarks.tables.making import Table, main
from client.shapes import write_ply
from schemas.mesh import DEFAULT_TEXELS, PreprocessOptions
from service.render.state import Gpu

HULL_FACES = 500
FACES = (500, 1_000, 2_000, 4_000, 8_000, 16_000, 32_000)
SIDE_PX, VIEWS = 512, 8
CURVES = {
    "no antialiasing: stencil, original": ("clipped_stencil_ms", "original_ms"),
    "antialiased: exact coverage, original with 4x MSAA": ("clipped_coverage_ms", "original_msaa4_ms"),
}


def measure(mesh: str, quick: bool, texels: int = DEFAULT_TEXELS) -> Result:
    """{points: [{faces, frame times}], coarse to fine, curves: {label: [faces drawn in full in equal time, or None]}}."""
    points = []
    gpu = Gpu(1024)
    try:
        with tempfile.TemporaryDirectory() as folder, mesh_file(mesh) as full:
            for path in _resolutions(full, Path(folder), FACES[::3] if quick else FACES):
                asset = frame.prepare(path, PreprocessOptions(hull_faces=HULL_FACES, texels=texels))
                times = frame.frame_times(gpu, asset, 2 if quick else VIEWS, SIDE_PX)
                points.append({"faces": len(asset.faces)} | {key: times[key] for pair in CURVES.values() for key in pair})
    finally:
        gpu.release()
    return {
        "size": SIDE_PX,
        "hull_faces": HULL_FACES,
        "points": points,
        "curves": {label: equal_time(points, *CURVES[label]) for label in CURVES},
    }


def _resolutions(full: Path, folder: Path, counts: tuple[int, ...]) -> list[Path]:
    positions, faces, _ = extraction.read(str(full))
    paths = []
    for count in counts:
        if count < len(faces):
            paths.append(folder / f"{count}.ply")
            write_ply(str(paths[-1]), *simplified(positions, faces, count))
    return [*paths, full]


def equal_time(points: list[Result], clipped: str, drawn: str) -> list[float | None]:
    """For each point's clipped time, how many faces drawn in full take as long, between the measured ones by logarithms.

    Less than the coarsest mesh counts as the coarsest. None: longer than drawing the finest.
    """
    faces = np.log([point["faces"] for point in points])
    spent = np.log(np.maximum.accumulate([point[drawn] for point in points]))
    wanted = np.log([point[clipped] for point in points])
    found = np.interp(wanted, spent, faces)
    return [None if time > spent[-1] else round(float(np.exp(y))) for time, y in zip(wanted, found, strict=True)]


def text(result: Result) -> str:
    """A table for each mesh."""
    parts = []
    for name, row in result["meshes"].items():
        lines = []
        for k, point in enumerate(row["points"]):
            spent = [number(point[key]) for pair in CURVES.values() for key in pair]
            equal = [number(row["curves"][label][k]) for label in CURVES]
            lines.append([number(point["faces"]), *spent[:2], equal[0], *spent[2:], equal[1]])
        head = ["faces", "clipped, ms", "drawn, ms", "equal", "clipped AA, ms", "drawn 4x MSAA, ms", "equal"]
        explained = EXPLAINED.format(name=name, hull=row["hull_faces"], size=row["size"])
        parts += [explained, markdown_table(head, lines)]
    return "\n\n".join(parts)


EXPLAINED = """\
{name}, simplified by quadrics to so many faces. Clipped: a hull of {hull} faces, clipped to the silhouette of that mesh, {size} x
{size}. Drawn: all its faces. Equal: how many faces drawn in full take as long as the clipped hull,
the coarsest where that is less, none where even the finest takes less."""


def plot(result: Result, folder: Path) -> list[str]:
    """The curves, and the diagonal on which clipping would gain nothing."""
    from benchmarks.tables.plots import COLORS, axes, plain_logarithmic, save

    names = []
    for name, row in result["meshes"].items():
        figure, made = axes("faces of the mesh that gives the silhouette", "faces drawn in full in equal time")
        faces = [point["faces"] for point in row["points"]]
        for (label, equal), color in zip(row["curves"].items(), (COLORS[2], COLORS[4]), strict=True):
            known = [(x, y) for x, y in zip(faces, equal, strict=True) if y is not None]
            made.loglog(*np.transpose(known or [(np.nan, np.nan)]), "o-", color=color, label=label)
            if equal[-1] is not None:
                made.loglog(faces[-1], equal[-1], "*", markersize=16, color=color)
                finer = f"{'at least ' if equal[-1] <= faces[0] else ''}{faces[-1] / equal[-1]:.1f} x finer"
                made.annotate(finer, (faces[-1], equal[-1]), (-10, 8), textcoords="offset points", ha="right")
        made.loglog([faces[0], faces[-1]], [faces[0], faces[-1]], "--", color=COLORS[0], label="as many: nothing gained")
        plain_logarithmic(made.xaxis)
        plain_logarithmic(made.yaxis)
        made.legend(frameon=False, title=f"clipped hull of {row['hull_faces']} faces, {row['size']} x {row['size']} px", alignment="left")
        names.append("figure11.png" if len(result["meshes"]) == 1 else f"figure11_{name}.png")
        save(figure, folder / names[-1])
    return names


TABLE = Table("figure11", "Figure 11: equal time", ("bunny_closed",), measure, text, plot)

if __name__ == "__main__":
    main(TABLE)
