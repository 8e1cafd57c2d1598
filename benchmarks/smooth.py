"""How much nearer a smooth outline is to the true one than a coarse mesh's own, and what it takes.

    python -m benchmarks.smooth [--size 512] [--views 12] [--json] [--picture FILE]

Coarse spheres, tori and a torus knot, generated, each against a fine mesh of the same surface: the pixels between its outline
and the true one, a view, for the mesh's own outline and for the smooth one, and their ratio. Milliseconds are medians of a
whole frame on the coverage rung without and with `smooth`, in turn in the same run. --picture writes the knot before and
after, side by side.
"""

from __future__ import annotations

import argparse
import statistics
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from PIL import Image

from benchmarks.frame import prepare
from benchmarks.report import report
from client.shapes import Faces, Vertices, torus_knot, tube, write_ply
from geometry.silhouettes import silhouette_scalar
from geometry.topology import build_edges
from schemas.conventions import U1, Frame
from schemas.mesh import PreprocessOptions
from schemas.render import Accuracy, Orbit, OrbitCamera, RenderRequest, Shading, ShadingMode
from service.assets import MeshAsset
from service.camera import resolve_camera
from service.measure.views import spread_view
from service.render.frame import render_frame
from service.render.state import Gpu
from service.silhouette.coverage import coverage_mask
from service.silhouette.project import project_edges

Mesh = tuple[Vertices, Faces]
PICTURED = "knot"
PICTURE = OrbitCamera(orbit=Orbit(azimuth_deg=30.0, elevation_deg=20.0))
PICTURE_PX = 420


def sphere(subdivisions: int) -> Mesh:
    made = trimesh.creation.icosphere(subdivisions)
    return np.asarray(made.vertices), np.asarray(made.faces, np.int32)


def torus(along: int, around: int) -> Mesh:
    angle = np.arange(along) / along * 2.0 * np.pi
    return tube(np.column_stack([np.cos(angle), np.sin(angle), 0.0 * angle]), 0.35, around)


PAIRS: dict[str, tuple[Mesh, Mesh]] = {
    "sphere 320": (sphere(2), sphere(6)),
    "sphere 1280": (sphere(3), sphere(6)),
    "torus 400": (torus(20, 10), torus(400, 200)),
    "torus 1024": (torus(32, 16), torus(400, 200)),
    PICTURED: (torus_knot(96, 10), torus_knot(1920, 80)),
}
"""Coarse mesh, fine mesh."""


class Fine:
    """The outline to reach."""

    def __init__(self, mesh: Mesh, frame: Frame) -> None:
        self.positions = frame.to_normalised(mesh[0]).astype(np.float32)
        self.faces = mesh[1]
        self.edges = build_edges(mesh[1])

    def mask(self, wanted: RenderRequest, frame: Frame) -> U1:
        """Its coverage in the view of a coarse mesh with this frame."""
        view = resolve_camera(wanted.camera, frame, wanted.width, wanted.height)
        edges = silhouette_scalar(self.positions, self.faces, self.edges.vertices, self.edges.faces, view.eye)
        return coverage_mask(project_edges(view, self.positions, edges), view.width, view.height).mask


def prepared(name: str) -> MeshAsset:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"{name}.ply"
        write_ply(str(path), *PAIRS[name][0])
        return prepare(path, PreprocessOptions())


def request(view: int, views: int, side: int, *, smooth: bool, mode: ShadingMode = ShadingMode.LAMBERT) -> RenderRequest:
    camera, accuracy = spread_view(view, views), Accuracy(smooth=smooth)
    return RenderRequest(camera=camera, width=side, height=side, accuracy=accuracy, shading=Shading(mode=mode))


def compare(gpu: Gpu, name: str, views: int, side: int) -> dict[str, Any]:
    asset = prepared(name)
    fine = Fine(PAIRS[name][1], asset.frame)
    area = {False: 0.0, True: 0.0}
    times: dict[bool, list[float]] = {False: [], True: []}
    for view in range(views):
        true = fine.mask(request(view, views, side, smooth=False), asset.frame).astype(float)
        for smooth in (False, True):
            made = render_frame(gpu, asset, request(view, views, side, smooth=smooth, mode=ShadingMode.MASK)).pixels[:, :, 3]
            area[smooth] += float(np.abs(made - true).sum()) / 255.0
    for turn in range(3 * views):
        for smooth in (False, True):
            wanted = request(turn % views, views, side, smooth=smooth)
            start = time.perf_counter()
            render_frame(gpu, asset, wanted)
            times[smooth].append((time.perf_counter() - start) * 1e3)
    return {
        "faces": len(asset.faces),
        "mesh_px": round(area[False] / views, 1),
        "smooth_px": round(area[True] / views, 1),
        "ratio": round(area[False] / area[True], 1),
        "ms": round(statistics.median(times[False]), 2),
        "smooth_ms": round(statistics.median(times[True]), 2),
    }


def draw(gpu: Gpu, path: Path) -> None:
    """The pictured shape before and after."""
    asset = prepared(PICTURED)
    halves = []
    for smooth in (False, True):
        wanted = RenderRequest(
            camera=PICTURE, width=PICTURE_PX, height=PICTURE_PX, background="#ffffff", accuracy=Accuracy(smooth=smooth),
            shading=Shading(color="#d8a060"),
        )  # fmt: skip
        halves.append(render_frame(gpu, asset, wanted).pixels)
    Image.fromarray(np.concatenate(halves, axis=1)[:, :, :3]).save(path, optimize=True)


def run(side: int, views: int, picture: Path | None) -> dict[str, Any]:
    gpu = Gpu(256)
    try:
        if picture is not None:
            draw(gpu, picture)
        return {"size": side, "views": views, "shapes": {name: compare(gpu, name, views, side) for name in PAIRS}}
    finally:
        gpu.release()


def table(result: dict[str, Any]) -> None:
    print(f"{result['size']}x{result['size']}, {result['views']} views")
    print("| mesh | faces | own outline off by | smooth off by | ratio | frame | with smooth |\n|---|---|---|---|---|---|---|")
    for name, row in result["shapes"].items():
        areas = f"{row['mesh_px']} px | {row['smooth_px']} px | {row['ratio']}"
        print(f"| {name} | {row['faces']:,} | {areas} | {row['ms']} ms | {row['smooth_ms']} ms |")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--size", type=int, default=512, help="pixels")
    parser.add_argument("--views", type=int, default=12)
    parser.add_argument("--picture", type=Path, help="write a picture here")
    parser.add_argument("--json", action="store_true", help="one JSON object instead of a table")
    given = parser.parse_args()
    report(lambda: run(given.size, given.views, given.picture), given.json, table)


if __name__ == "__main__":
    main()
