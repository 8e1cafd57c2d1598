"""What a mesh costs a frame whose vertices move, against one that stays, and against one that is read anew for each frame.

    python -m benchmarks.deform MESH [--size 512] [--frames 24] [--json]

MESH is a file or a name that `benchmarks.models` knows. It twists about its y axis, a little further in each frame. `still` is the unmoved
mesh; `moved` a frame of a sequence, from its positions in memory to pixels in memory: `pose` (positions and normals, on the CPU, beside the
renderer) and the frame, `deform` of which gives them to the GL; `alone` a moved picture by itself, after which the GL forgets it. `anew`:
the same positions in a PLY file are read, repaired, indexed, uploaded, drawn and forgotten, as by `POST /v1/render`. All are the original
with 4 samples a pixel, encoding apart, medians over the frames; the three take turns in every frame.
"""

from __future__ import annotations

import statistics
import tempfile
import time
from collections import defaultdict
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.lines import loaded
from benchmarks.models import mesh_file
from benchmarks.report import markdown_table, mesh_parser, number, ratio, report, times
from client.shapes import write_ply
from schemas.conventions import F8
from schemas.lines import LineMethod, Lines
from schemas.render import Accuracy, RenderRequest
from service.assets import MeshAsset
from service.moving import Moving
from service.render.frame import render_frame
from service.render.state import Gpu

KINDS = {"plain": None, "edge_mesh": Lines(ridge={}, valley={}), "fattened": Lines(method=LineMethod.FATTENED)}
TURN = 0.5
"""Radians by which the last frame is twisted, over the radius."""


def twisted(asset: MeshAsset, part: float) -> F8:
    """(v, 3) f8 model units: twisted by so much of TURN."""
    x, y, z = asset.positions.astype(np.float64).T
    angle = TURN * part * y
    turned = np.column_stack([x * np.cos(angle) + z * np.sin(angle), y, z * np.cos(angle) - x * np.sin(angle)])
    return asset.frame.to_model(turned)


def timed(gpu: Gpu, asset: MeshAsset, wanted: RenderRequest) -> tuple[float, dict[str, float]]:
    """(milliseconds of a frame, of each of its passes)."""
    start = time.perf_counter()
    image = render_frame(gpu, asset, wanted, true_times=False)
    return (time.perf_counter() - start) * 1e3, dict(image.passes)


def measured(gpu: Gpu, asset: MeshAsset, wanted: RenderRequest, frames: int, folder: Path) -> dict[str, float]:
    """Medians of one kind of picture."""
    moving, took = Moving(asset), defaultdict[str, list[float]](list)
    for frame in range(frames + 1):
        places = twisted(asset, frame / frames)
        took["still"].append(timed(gpu, asset, wanted)[0])
        start = time.perf_counter()
        moved = moving.at(places)
        took["pose"].append((time.perf_counter() - start) * 1e3)
        ms, passes = timed(gpu, moved, wanted)
        took["moved"].append(took["pose"][-1] + ms)
        took["deform"].append(passes["deform"])
        start = time.perf_counter()
        other = Moving(asset)
        render_frame(gpu, other.at(places), wanted)
        gpu.cache.drop(other.id)
        took["alone"].append((time.perf_counter() - start) * 1e3)
        write_ply(str(folder / "moved.ply"), places, asset.faces)
        start = time.perf_counter()
        anew = loaded(folder / "moved.ply")
        render_frame(gpu, anew, wanted)
        gpu.cache.drop(anew.id)
        took["anew"].append((time.perf_counter() - start) * 1e3)
    gpu.cache.drop(moving.id)
    return {name: round(statistics.median(values[1:]), 3) for name, values in took.items()}


def run(mesh: str, side: int, frames: int) -> dict[str, Any]:
    with mesh_file(mesh) as path:
        asset = loaded(path)
    gpu = Gpu(1024)
    result: dict[str, Any] = {"mesh": Path(mesh).name, "faces": len(asset.faces), "vertices": len(asset.positions), "size": side}
    result |= {"frames": frames, "renderer": gpu.ctx.info["GL_RENDERER"]}
    accuracy = Accuracy(source="original", antialias="msaa")
    try:
        with tempfile.TemporaryDirectory() as folder:
            for name, lines in KINDS.items():
                wanted = RenderRequest(width=side, height=side, accuracy=accuracy, lines=lines)
                result[name] = measured(gpu, asset, wanted, frames, Path(folder))
    finally:
        gpu.release()
    return result


def print_table(result: dict[str, Any]) -> None:
    print(f"{result['mesh']}: {result['faces']:,} faces, {result['vertices']:,} vertices, {result['size']} px, {result['renderer']}")
    columns = ("still", "moved", "pose", "deform", "alone", "anew")
    rows = []
    for name in KINDS:
        ms = result[name]
        rows.append([name, *(number(ms[column]) for column in columns), times(ratio(ms["moved"], ms["still"]))])
        rows[-1].append(times(ratio(ms["anew"], ms["moved"])))
    print(markdown_table(["ms a frame", *columns, "moved / still", "anew / moved"], rows))


def main() -> None:
    parser = mesh_parser(__doc__ or "")
    parser.add_argument("--size", type=int, default=512, help="pixels along each side")
    parser.add_argument("--frames", type=int, default=24)
    given = parser.parse_args()
    report(lambda: run(given.mesh, given.size, given.frames), given.json, print_table)


if __name__ == "__main__":
    main()
