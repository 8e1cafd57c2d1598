"""What lines cost over the plain picture, by method.

    python -m benchmarks.lines MESH [--size 512] [--views 40] [--antialias msaa] [--json]

MESH is a file or a name that `benchmarks.models` knows; any triangles will do. The plain picture is the original's on the same rung. The
methods take turns in every view, each after a frame of its own that is not timed, so that what else the machine does meets all alike.
Times are medians over the views, from the resolved request to pixels in memory, readback included, encoding apart. A ratio is the median
of the views' ratios to the plain picture. `passes` are those that lines add, with a wait after each.
"""

from __future__ import annotations

import statistics
import time
from collections import defaultdict
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.models import mesh_file
from benchmarks.report import markdown_table, mesh_parser, number, report, times
from schemas.lines import LineMethod, Lines
from schemas.mesh import PreprocessOptions
from schemas.render import Accuracy, Antialias, RenderRequest, Source
from service.assets import MeshAsset
from service.measure.views import spread_view
from service.render.frame import render_frame
from service.render.state import Gpu
from worker.load import LoadedMesh, load_mesh

PLAIN = "plain"
BARS = {"wireframe": 1.65, "translated": 1.32, "fattened": 5.7, "edge_mesh": 2.5}
"""Ratios that Image Precision Silhouette Edges, section 5, had; and what is asked of the edge mesh."""
ROUNDS = 3


def loaded(path: Path) -> MeshAsset:
    """The mesh as a picture with lines takes it: its original alone."""
    return original_of(load_mesh(path, path.suffix, PreprocessOptions()), path.name)


def original_of(mesh: LoadedMesh, name: str) -> MeshAsset:
    """A mesh that has been read, without anything that clipping needs."""
    shading = mesh.shading.tensors()
    return MeshAsset(
        id=name,
        frame=mesh.frame,
        positions=mesh.positions,
        faces=mesh.faces,
        normals=mesh.shading.normals,
        appearance=mesh.appearance,
        edges=None if mesh.edges is None else (mesh.edges.vertices, mesh.edges.faces),
        hull=None,
        maps=None,
        tree=None,
        clip=mesh.clip,
        normal_vertices=shading.get("normal_vertices"),
        corner_normals=shading.get("corner_normals"),
    )


def request(view: int, views: int, side: int, antialias: Antialias, lines: Lines | None) -> RenderRequest:
    accuracy = Accuracy(source=Source.ORIGINAL, antialias=antialias)
    return RenderRequest(camera=spread_view(view, views), width=side, height=side, accuracy=accuracy, lines=lines)


def drawable(gpu: Gpu, asset: MeshAsset, side: int, antialias: Antialias) -> dict[str, Lines | None]:
    """What is compared, by name: plain, and every method. Compiles and uploads."""
    compared: dict[str, Lines | None] = {PLAIN: None} | {method.value: Lines(method=method) for method in LineMethod}
    for lines in compared.values():
        render_frame(gpu, asset, request(0, 1, side, antialias, lines))
    return compared


def measured(gpu: Gpu, asset: MeshAsset, views: int, side: int, antialias: Antialias) -> dict[str, Any]:
    """Medians of all methods, of their ratios to the plain picture, and of the passes that they add."""
    compared = drawable(gpu, asset, side, antialias)
    ms: dict[str, list[float]] = defaultdict(list)
    passes: dict[str, dict[str, list[float]]] = defaultdict(lambda: defaultdict(list))
    for view in range(views):
        best = dict.fromkeys(compared, float("inf"))
        for _ in range(ROUNDS):
            for name, lines in compared.items():
                wanted = request(view, views, side, antialias, lines)
                render_frame(gpu, asset, wanted)
                start = time.perf_counter()
                render_frame(gpu, asset, wanted)
                best[name] = min(best[name], (time.perf_counter() - start) * 1e3)
        for name, lines in compared.items():
            ms[name].append(best[name])
            for step, took in render_frame(gpu, asset, request(view, views, side, antialias, lines), true_times=True).passes:
                passes[name][step].append(took)
    plain_passes = set(passes[PLAIN])
    result: dict[str, Any] = {f"{name}_ms": round(statistics.median(values), 3) for name, values in ms.items()}
    plain = np.array(ms[PLAIN])
    result["ratios"] = {name: round(float(np.median(np.array(values) / plain)), 3) for name, values in ms.items() if name != PLAIN}
    result["passes"] = {
        name: {step: round(statistics.median(took), 3) for step, took in steps.items() if step not in plain_passes}
        for name, steps in passes.items()
        if name != PLAIN
    }
    return result


def run(mesh: str, side: int, views: int, antialias: Antialias) -> dict[str, Any]:
    with mesh_file(mesh) as path:
        asset = loaded(path)
    gpu = Gpu(1024)
    try:
        result = {"mesh": Path(mesh).name, "faces": len(asset.faces), "closed": asset.edges is not None, "size": side, "views": views}
        result |= {"antialias": antialias.value, "renderer": gpu.ctx.info["GL_RENDERER"]}
        return result | measured(gpu, asset, views, side, antialias)
    finally:
        gpu.release()


def print_table(result: dict[str, Any]) -> None:
    kind = "closed" if result["closed"] else "open"
    print(f"{result['mesh']}: {result['faces']:,} faces, {kind}, {result['size']} px, {result['antialias']}, {result['renderer']}")
    rows = [[PLAIN, number(result[f"{PLAIN}_ms"]), times(1.0), "", ""]]
    for name, ratio in result["ratios"].items():
        added = ", ".join(f"{step} {ms:.2f}" for step, ms in result["passes"][name].items())
        rows.append([name, number(result[f"{name}_ms"]), times(ratio), times(BARS.get(name)), added])
    print(markdown_table(["lines", "ms", "to plain", "at most", "passes added, ms"], rows))


def main() -> None:
    parser = mesh_parser(__doc__ or "")
    parser.add_argument("--size", type=int, default=512, help="pixels along each side")
    parser.add_argument("--views", type=int, default=40)
    parser.add_argument("--antialias", type=Antialias, default=Antialias.MSAA, choices=[Antialias.NONE, Antialias.MSAA, Antialias.SSAA])
    given = parser.parse_args()
    report(lambda: run(given.mesh, given.size, given.views, given.antialias), given.json, print_table)


if __name__ == "__main__":
    main()
