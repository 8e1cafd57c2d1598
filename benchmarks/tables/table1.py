"""Table 1 of Silhouette Clipping: milliseconds of every step of a frame, and how much slower drawing the original is.

    python -m benchmarks.tables.table1 [MESH ...] [--quick] [--json] [--out DIR]

512 x 512, Mesa's llvmpipe where there is no GPU. Frame times are medians of whole frames, readback included; steps are medians
of frames that wait after each pass and so take longer than the frame.
"""

from __future__ import annotations

import statistics
from collections import defaultdict
from collections.abc import Callable
from pathlib import Path

from benchmarks import frame
from benchmarks.models import mesh_file
from benchmarks.paper import MACHINE, NAMES, TABLE_1
from benchmarks.report import Result, markdown_table, number, ratio, times
from benchmarks.tables.making import Table, main
from schemas.mesh import DEFAULT_TEXELS, PreprocessOptions
from service.assets import MeshAsset
from service.render.frame import render_frame
from service.render.state import Gpu

MESHES = ("bunny_closed", "dragon_400k", "armadillo_86k", "knot", "holes3")
HULL_FACES = {"bunny_closed": 500, "dragon_400k": 4_000, "knot": 928, "holes3": 500}
"""Faces of the paper's hulls; others get as many as its parasaur."""
PARASAUR_HULL_FACES = 1_020
SIDE_PX = 512
VIEWS, VIEWS_OF_ERROR = 20, 4
STEPS = {"edges": "extraction", "surface": "hull", "rim": "hull"} | dict.fromkeys(
    ("loops", "stencil", "segments", "outline", "interior", "coverage"), "mask"
)
"""Which step of the paper a pass belongs to; the others (clear, read, composite) are the rest."""
RUNGS = {"stencil": "clipped_stencil_ms", "line": "clipped_line_ms", "coverage": "clipped_coverage_ms"}


def measure(mesh: str, quick: bool, texels: int = DEFAULT_TEXELS) -> Result:
    """Frame times of all rungs, steps of the clipped ones, error of the outline."""
    views = 2 if quick else VIEWS
    with mesh_file(mesh) as path:
        hull_faces = HULL_FACES.get(path.stem, PARASAUR_HULL_FACES)
        asset = frame.prepare(path, PreprocessOptions(hull_faces=hull_faces, texels=texels))
    gpu = Gpu(1024)
    try:
        result = {"faces": len(asset.faces), "hull_faces": len(asset.hull["faces"]) if asset.hull else 0, "size": SIDE_PX}
        result |= {"renderer": gpu.ctx.info["GL_RENDERER"]} | frame.frame_times(gpu, asset, views, SIDE_PX)
        result["steps"] = {rung: step_times(gpu, asset, views, frame.RUNGS[name]) for rung, name in RUNGS.items()}
        result["outline"] = frame.outline_error(gpu, asset, 1 if quick else VIEWS_OF_ERROR, SIDE_PX)
    finally:
        gpu.release()
    return result


def step_times(gpu: Gpu, asset: MeshAsset, views: int, rung: tuple) -> dict[str, float]:
    """Median milliseconds of extraction, mask, hull and the rest, over frames that wait after each pass."""
    frames: dict[str, list[float]] = defaultdict(list)
    for view in range(views):
        wanted = frame.request(view, views, SIDE_PX, rung)
        for again in range(3):
            sums = dict.fromkeys(("extraction", "mask", "hull", "rest"), 0.0)
            for name, ms in render_frame(gpu, asset, wanted, true_times=True).passes:
                sums[STEPS.get(name, "rest")] += ms
            for step, ms in sums.items() if again else ():
                frames[step].append(ms)
    return {step: round(statistics.median(values), 3) for step, values in frames.items()}


def text(result: Result) -> str:
    """Our table, the paper's, and what the rows mean."""
    meshes = result["meshes"]
    head = ["512 x 512, milliseconds", *meshes]
    renderer = next(iter(meshes.values()))["renderer"]
    ours = markdown_table(head, [[title, *(cell(row) for row in meshes.values())] for title, cell in _rows().items()])
    parts = [EXPLAINED.format(renderer=renderer), ours]
    if names := [name for name in meshes if name in NAMES]:
        paper = [[title, *(cell(TABLE_1[NAMES[name]]) for name in names)] for title, cell in _paper_rows().items()]
        parts += ["The paper's, where the model is the same. Its totals overlap extraction and drawing."]
        parts += [markdown_table([f"{MACHINE}, milliseconds", *names], paper)]
    return "\n\n".join(parts)


EXPLAINED = """\
Drawn by {renderer}. Frames are whole, readback included. Steps are those of frames that wait after each pass; a frame without the
waits is faster than their sum."""


def _rows() -> dict[str, Callable[[Result], str]]:
    rows: dict[str, Callable[[Result], str]] = {
        "faces": lambda row: number(row["faces"]),
        "faces of the hull": lambda row: number(row["hull_faces"]),
        "**original**, no antialiasing": lambda row: number(row["original_ms"]),
        "**original**, 4x MSAA": lambda row: number(row["original_msaa4_ms"]),
        "silhouette extraction": lambda row: number(row["steps"]["stencil"]["extraction"]),
        "stencil setting": lambda row: number(row["steps"]["stencil"]["mask"]),
        "drawing the hull": lambda row: number(row["steps"]["stencil"]["hull"]),
        "clear, read, composite": lambda row: number(row["steps"]["stencil"]["rest"]),
        "**clipped**, stencil, no antialiasing": lambda row: number(row["clipped_stencil_ms"]),
        "**clipped**, lines into alpha": lambda row: number(row["clipped_line_ms"]),
        "coverage mask": lambda row: number(row["steps"]["coverage"]["mask"]),
        "**clipped**, exact coverage": lambda row: number(row["clipped_coverage_ms"]),
        "the same straight after a frame of the original": lambda row: number(row["clipped_coverage_cold_ms"]),
    }
    speed_ups = {
        "original / clipped stencil": ("original_ms", "clipped_stencil_ms"),
        "original / clipped coverage": ("original_ms", "clipped_coverage_ms"),
        "original / clipped coverage after another rung": ("original_ms", "clipped_coverage_cold_ms"),
        "original 4x MSAA / clipped coverage": ("original_msaa4_ms", "clipped_coverage_ms"),
    }
    rows |= {title: lambda row, pair=pair: times(ratio(row[pair[0]], row[pair[1]])) for title, pair in speed_ups.items()}
    rows["error of coverage on outline pixels"] = lambda row: number(row["outline"]["mean_abs_error_edge_pixels"], 2)
    return rows


def _paper_rows() -> dict[str, Callable[[dict[str, float]], str]]:
    return {
        "faces": lambda row: number(row["faces"]),
        "faces of the hull": lambda row: number(row["hull_faces"]),
        "original": lambda row: number(row["original"]),
        "silhouette extraction": lambda row: number(row["extraction"]),
        "stencil setting": lambda row: number(row["stencil"]),
        "drawing the hull": lambda row: number(row["hull"]),
        "clipped, no antialiasing": lambda row: number(row["total"]),
        "clipped, lines into alpha": lambda row: number(row["total"] + row["antialiasing"]),
        "original / clipped": lambda row: times(row["speed_up"]),
        "original / clipped with lines": lambda row: times(row["original"] / (row["total"] + row["antialiasing"])),
    }


def plot(result: Result, folder: Path) -> list[str]:
    """Frame times as bars."""
    from benchmarks.tables.plots import bars

    kinds = {
        "original": "original_ms",
        "original, 4x MSAA": "original_msaa4_ms",
        "clipped, stencil": "clipped_stencil_ms",
        "clipped, lines": "clipped_line_ms",
        "clipped, coverage": "clipped_coverage_ms",
    }
    series = {label: [row[key] for row in result["meshes"].values()] for label, key in kinds.items()}
    bars(folder / "table1.png", list(result["meshes"]), series, "a frame of 512 x 512, ms (log scale)")
    return ["table1.png"]


TABLE = Table("table1", "Table 1: steps of a frame", MESHES, measure, text, plot)

if __name__ == "__main__":
    main(TABLE)
