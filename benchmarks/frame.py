"""Milliseconds a frame of every rung, and how exact the clipped outline is, for one mesh.

    python -m benchmarks.frame MESH --size 512 [--views 20] [--json]

MESH is a file or a name that `benchmarks.models` knows. Its hull, maps and tree are made first, in this process.
The rungs take turns in the same run: each draws all views one after the other, as a client that turns the mesh has it, then the
next one does, and that ROUNDS times. Times are medians, from the resolved request to pixels in memory, readback included,
encoding apart. `clipped_coverage_cold_ms` is a coverage frame straight after one of the original, which leaves nothing of it in the
caches. `passes` are those of the coverage rung with a wait after each (a frame without the waits is faster than their sum).
`outline` compares the alpha of `coverage` with the original drawn binary at 16 x 16 times the pixels: mean absolute error over the
pixels that are neither fully in nor fully out, and the percentage of the others that are off by more than 0.02 (a sliver along a
pixel's border can lie between the samples).
"""

from __future__ import annotations

import statistics
import time
from collections import defaultdict
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.lines import original_of
from benchmarks.models import mesh_file
from benchmarks.report import mesh_parser, report
from schemas.conventions import F8
from schemas.mesh import PreprocessOptions
from schemas.render import MAX_SIDE_PX, Accuracy, Antialias, ImageFormat, RenderRequest, Shading, ShadingMode, Source
from service.assets import DrawnHull, MeshAsset
from service.measure.views import spread_view
from service.render.encode import encode
from service.render.frame import RenderedImage, render_frame
from service.render.state import Gpu
from service.silhouette.extract import SilhouetteTree
from service.silhouette.levels import SilhouetteLevel
from worker.bake import bake_maps, hull_normals
from worker.hull import Hull, build_hull
from worker.hulls import HullSource, other_hulls
from worker.levels import build_levels
from worker.load import LoadedMesh, load_mesh
from worker.tree import build_tree

RUNGS = {
    "original_ms": (Source.ORIGINAL, Antialias.NONE),
    "original_msaa4_ms": (Source.ORIGINAL, Antialias.MSAA),
    "clipped_stencil_ms": (Source.CLIPPED, Antialias.NONE),
    "clipped_line_ms": (Source.CLIPPED, Antialias.LINE),
    "clipped_coverage_ms": (Source.CLIPPED, Antialias.COVERAGE),
}
COVERAGE = "clipped_coverage_ms"
ROUNDS = 3
SAMPLES = 16
WRONG = 0.02


def silent(_: float) -> None:
    return None


def prepare(path: Path, options: PreprocessOptions, *, every_rung: bool = False) -> MeshAsset:
    """The mesh with everything that clipping needs. every_rung: with its silhouette levels and its hulls of other sizes, too."""
    mesh = load_mesh(path, path.suffix, options)
    if mesh.edges is None or not mesh.clip.available:
        raise SystemExit(f"this mesh cannot be clipped: {mesh.clip.reason}")
    edges = mesh.edges
    hull = build_hull(mesh.positions, mesh.faces, options.hull_faces, silent)
    normals = hull_normals(hull.positions, hull.faces)
    shading = mesh.shading.tensors()
    original = (mesh.positions, mesh.faces, mesh.shading.normals, mesh.appearance)
    rows = shading.get("corner_normals")
    maps = bake_maps(hull.positions, hull.faces, normals, *original, options.texels, silent, corner_normals=rows)
    tree = build_tree(mesh.positions, mesh.faces, edges.vertices, edges.faces, silent)
    tensors = {"positions": mesh.positions, "faces": mesh.faces, "edge_vertices": edges.vertices, "edge_faces": edges.faces}
    return replace(
        original_of(mesh, path.name),
        hull={"positions": hull.positions, "faces": hull.faces, "normals": normals},
        maps={"tile_uv": maps.tile_uv, "normal": maps.normal} | ({} if maps.color is None else {"color": maps.color}),
        tree=SilhouetteTree(tensors, tree.tensors()),
        levels=_levels(mesh, hull) if every_rung else (),
        other_hulls=_other_hulls(mesh, hull, options) if every_rung else (),
    )


def _levels(mesh: LoadedMesh, hull: Hull) -> tuple[SilhouetteLevel, ...]:
    steps = (hull.step_vertices, hull.step_positions)
    made = build_levels(mesh.positions, mesh.faces, steps, len(hull.faces), silent)
    return tuple(SilhouetteLevel(level.tensors(), level.tree.tensors()) for level in made)


def _other_hulls(mesh: LoadedMesh, hull: Hull, options: PreprocessOptions) -> tuple[DrawnHull, ...]:
    tensors = {"positions": mesh.positions, "faces": mesh.faces} | mesh.shading.tensors()
    drawn = {"positions": hull.positions, "faces": hull.faces, "normals": hull_normals(hull.positions, hull.faces)}
    sequence = {"step_vertices": hull.step_vertices, "step_positions": hull.step_positions}
    made, _ = other_hulls(HullSource(tensors, drawn, sequence, mesh.appearance, options.texels), silent)
    return tuple(DrawnHull(one.hull, one.maps) for one in made if one is not None)


def request(view: int, views: int, side: int, rung: tuple[Source, Antialias], mode: ShadingMode = ShadingMode.LAMBERT) -> RenderRequest:
    """One of `views` cameras spread evenly over the sphere of directions."""
    accuracy = Accuracy(source=rung[0], antialias=rung[1])
    return RenderRequest(camera=spread_view(view, views), width=side, height=side, accuracy=accuracy, shading=Shading(mode=mode))


def frame_times(gpu: Gpu, asset: MeshAsset, views: int, side: int) -> dict[str, Any]:
    """Medians of all rungs, of the coverage rung after another, of its passes, and of encoding its pictures."""
    times: dict[str, list[float]] = defaultdict(list)
    passes: dict[str, list[float]] = defaultdict(list)

    def draw(view: int, rung: str, into: str | None = None) -> RenderedImage:
        wanted = request(view, views, side, RUNGS[rung])
        start = time.perf_counter()
        image = render_frame(gpu, asset, wanted)
        if into is not None:
            times[into].append((time.perf_counter() - start) * 1e3)
        return image

    for rung in RUNGS:  # compiles and uploads
        draw(0, rung)
    for _ in range(ROUNDS):
        for rung in RUNGS:
            for view in range(views):
                draw(view, rung, rung)
        for view in range(views):
            draw(view, "original_ms")
            image = draw(view, COVERAGE, "clipped_coverage_cold_ms")
            start = time.perf_counter()
            encode(image.pixels, ImageFormat.PNG)
            times["encode_png_ms"].append((time.perf_counter() - start) * 1e3)
            waited = render_frame(gpu, asset, request(view, views, side, RUNGS[COVERAGE]), true_times=True)
            for name, ms in waited.passes:
                passes[name].append(ms)
    medians = {name: round(statistics.median(values), 3) for name, values in times.items()}
    return medians | {"passes": {name: round(statistics.median(values), 3) for name, values in passes.items()}}


def alpha(gpu: Gpu, asset: MeshAsset, wanted: RenderRequest) -> F8:
    return render_frame(gpu, asset, wanted).pixels[:, :, 3]


def outline_error(gpu: Gpu, asset: MeshAsset, views: int, side: int) -> dict[str, Any]:
    """Alpha of the coverage rung against the supersampled original, over all views."""
    samples = min(SAMPLES, MAX_SIDE_PX // side)
    error, edges, wrong, others = 0.0, 0, 0, 0
    for view in range(views):
        made = alpha(gpu, asset, request(view, views, side, (Source.CLIPPED, Antialias.COVERAGE))) / 255.0
        binary = alpha(gpu, asset, request(view, views, side * samples, (Source.ORIGINAL, Antialias.NONE), ShadingMode.MASK))
        inside = (binary > 127).reshape(side, samples, side, samples).sum(axis=(1, 3), dtype=np.int32)
        edge = (inside > 0) & (inside < samples**2)
        difference = np.abs(made - inside / samples**2)
        error += float(difference[edge].sum())
        edges += int(edge.sum())
        wrong += int((difference[~edge] > WRONG).sum())
        others += int((~edge).sum())
    return {
        "mean_abs_error_edge_pixels": round(error / max(edges, 1), 5),
        "wrong_other_pixels_percent": round(100.0 * wrong / max(others, 1), 5),
        "edge_pixels": edges,
        "samples_per_pixel": samples**2,
    }


def run(mesh: str, side: int, views: int) -> dict[str, Any]:
    with mesh_file(mesh) as path:
        asset = prepare(path, PreprocessOptions())
    gpu = Gpu(1024)
    try:
        faces = {"faces": len(asset.faces), "hull_faces": len(asset.hull["faces"]) if asset.hull else 0}
        result = {"mesh": Path(mesh).name, **faces, "size": side}
        result |= {"renderer": gpu.ctx.info["GL_RENDERER"]} | frame_times(gpu, asset, views, side)
        result["outline"] = outline_error(gpu, asset, views, side)
    finally:
        gpu.release()
    return result


def print_table(result: dict[str, Any]) -> None:
    print(f"{result['mesh']}: {result['faces']} faces, hull {result['hull_faces']}, {result['size']} px, {result['renderer']}")
    slowest = result["original_msaa4_ms"]
    for name in RUNGS:
        print(f"  {name.removesuffix('_ms'):<18} {result[name]:>8.2f} ms   {slowest / result[name]:>6.1f} x")
    print(f"  coverage, first frame after another rung: {result['clipped_coverage_cold_ms']:.2f} ms")
    print("  passes of coverage: " + ", ".join(f"{name} {ms:.2f}" for name, ms in result["passes"].items()))
    print(f"  PNG {result['encode_png_ms']:.2f} ms")
    outline = result["outline"]
    print(
        f"  outline: error {outline['mean_abs_error_edge_pixels']:.4f}, {outline['wrong_other_pixels_percent']:.4f} % of the others wrong"
    )


def main() -> None:
    parser = mesh_parser(__doc__ or "")
    parser.add_argument("--size", type=int, default=512, help="pixels along each side")
    parser.add_argument("--views", type=int, default=20)
    arguments = parser.parse_args()
    report(lambda: run(arguments.mesh, arguments.size, arguments.views), arguments.json, print_table)


if __name__ == "__main__":
    main()
