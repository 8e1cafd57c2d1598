"""What accuracy costs: every rung's error and time, the plot, and how good the planner's predictions and choices are.

    python -m benchmarks.tables.accuracy [MESH ...] [--quick] [--json] [--out DIR]

512 x 512, the measured ladder of `service.measure` with the service's own code, and `benchmarks.planner` on the same mesh.
"""

from __future__ import annotations

from pathlib import Path

from benchmarks import planner
from benchmarks.accuracy import as_result, bars, ladder_of, stencil_error
from benchmarks.frame import prepare
from benchmarks.models import mesh_file
from benchmarks.report import Result, markdown_table, number
from benchmarks.tables.making import PICTURES, Table, main
from schemas.ladder import VIEWS
from schemas.mesh import PreprocessOptions
from service.accuracy.plot import accuracy_svg
from service.accuracy.report import accuracy_report

MESHES = ("bunny_closed", "dragon_400k", "knot", "holes3", "fandisk")
SIDE_PX = 512
STENCIL_VIEWS = 100
SEED = 1


def measure(mesh: str, quick: bool) -> Result:
    """The ladder, the stencil's error, and the planner's quality."""
    views = 2 if quick else VIEWS
    with mesh_file(mesh) as path:
        asset = prepare(path, PreprocessOptions(), every_rung=True)
    gpu, calibration_s = planner.calibrated()
    try:
        planned = {} if quick else planner.evaluate(gpu, asset, SEED)
        ladder = ladder_of(gpu, asset, SIDE_PX, views)
        result = {"faces": len(asset.faces)} | as_result(gpu, ladder, SIDE_PX, views)
        result["stencil"] = stencil_error(gpu, asset, SIDE_PX, 2 if quick else STENCIL_VIEWS)
    finally:
        gpu.release()
    report = accuracy_report("0" * 32, Path(mesh).stem, ladder, SIDE_PX, None, {})
    result |= {"bars": list(bars(result)), "planner": planned, "calibration_s": round(calibration_s, 2)}
    return result | {"front": report.pareto.model_dump(), PICTURES: {"svg": accuracy_svg(report)}}


def text(result: Result) -> str:
    """The outlines of all meshes, the planner, then each mesh's fronts."""
    meshes = result["meshes"]
    device = next(iter(meshes.values()))["device"]
    parts = [f"{SIDE_PX} x {SIDE_PX} pixels, drawn by {device}; errors against the original at 16 x 16 samples a pixel."]
    parts += ["## Outlines", _outlines(meshes)]
    if all(row["planner"] for row in meshes.values()):
        parts += ["## The planner", PLANNER, _planner(meshes)]
    for name, row in meshes.items():
        parts += [f"## {name}: rungs that no other one beats", _fronts(row)]
    return "\n\n".join(parts)


PLANNER = """\
Predicted times are counted within 25 % of what a frame took, for a client that turns the mesh, from its third frame on. A choice is right
when it is the rung that trying all of them finds best, or keeps the same promises and takes at most 15 % longer than that."""


def _outlines(meshes: dict[str, Result]) -> str:
    rows = []
    for name, row in meshes.items():
        own = {(rung["source"], rung["antialias"]): rung for rung in row["rungs"] if rung["level"] is None}
        for (source, antialias), rung in own.items():
            cells = [number(rung[key], 2) for key in ("alpha_error", "alpha_rmse", "distance_px", "wrong_pixels")]
            rows.append([name, f"{source}/{antialias}", *cells, number(rung["ms"])])
        rows.append([name, "pixels of the stencil that differ", number(row["stencil"]["total"], 2), "", "", "", ""])
    return markdown_table(["mesh", "rung", "alpha error", "RMSE", "distance, px", "wrong pixels", "ms"], rows)


def _planner(meshes: dict[str, Result]) -> str:
    head = ["", *meshes]
    rows: list[list[str]] = [
        ["rungs", *(number(row["planner"]["rungs"]) for row in meshes.values())],
        ["predictions within 25 %", *(f"{row['planner']['within_25_percent']:.1%}" for row in meshes.values())],
        ["right choices", *(f"{row['planner']['right_choices']:.0%}" for row in meshes.values())],
        ["as accurate as the best", *(f"{row['planner']['as_accurate']:.0%}" for row in meshes.values())],
        ["planning, microseconds", *(number(row["planner"]["planning_us"]) for row in meshes.values())],
        ["calibration, s", *(number(row["calibration_s"], 2) for row in meshes.values())],
    ]
    return markdown_table(head, rows)


def _fronts(row: Result) -> str:
    best = sorted(set(row["front"]["outline"]) | set(row["front"]["shading"]), key=lambda n: row["rungs"][n]["ms"])
    rows = []
    for n in best:
        rung = row["rungs"][n]
        level = "" if rung["level"] is None else f", outline of {rung['level_faces']:,} faces"
        hull = "" if rung["hull_faces"] is None else f", hull of {rung['hull_faces']:,}, {rung['texels']} texels"
        marks = " ".join(word for word in ("outline", "shading") if n in row["front"][word])
        rows.append(
            [
                f"{rung['source']}/{rung['antialias']}{level}{hull}",
                number(rung["ms"]),
                number(rung["alpha_error"], 2),
                f"{rung['psnr']:.1f}",
                marks,
            ]
        )
    return markdown_table(["rung", "ms", "alpha error", "PSNR, dB", "best in"], rows)


def plot(result: Result, folder: Path) -> list[str]:
    """The service's own plot of each mesh."""
    names = []
    for mesh, row in result["meshes"].items():
        names.append(f"accuracy_{mesh}.svg")
        (folder / names[-1]).write_text(row[PICTURES]["svg"])
    return names


TABLE = Table("accuracy", "What accuracy costs in time", MESHES, measure, text, plot)

if __name__ == "__main__":
    main(TABLE)
