"""How exact every rung of a mesh is and what a frame of it takes: the measured ladder, made in this process.

    python -m benchmarks.accuracy MESH --size 512 [--views 12] [--samples 4] [--stencil VIEWS] [--texels 1024] [--json]

MESH is a file or a name that `benchmarks.models` knows. Its hulls, maps, tree and levels are made first. Errors are those of
`service.measure.errors`, against the original at 16 x 16 samples a pixel; `ms` is the median of a frame of each view. --samples: of the
rung msaa in a pixel, as many as the driver has at most; 4 is what the service draws. --stencil compares the binary mask of `clipped/none`
with the original drawn without antialiasing, in so many views: pixels that differ, as parts of all pixels of the pictures.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from benchmarks.frame import prepare
from benchmarks.models import mesh_file
from benchmarks.report import mesh_parser, report
from schemas.conventions import Array
from schemas.ladder import SAMPLES, VIEWS, Ladder, MeasuredRung
from schemas.mesh import DEFAULT_TEXELS, PreprocessOptions
from schemas.render import Accuracy, Antialias, AnyCamera, RenderRequest, Shading, ShadingMode, Source
from service.assets import MeshAsset
from service.measure.ladder import measure_step, put_together, steps
from service.measure.views import spread_view
from service.render.frame import render_frame
from service.render.state import Gpu

MSAA_SAMPLES = 4
COVERAGE_ERROR, COVERAGE_RMSE, LINE_ERROR, STENCIL_PART = 0.008, 0.015, 0.06, 1e-4
"""What is demanded at most."""
PART_OF_MSAA = 1.0 / 3.0


def run(
    mesh: str, size: int, views: int, samples: int = MSAA_SAMPLES, stencil_views: int = 0, texels: int = DEFAULT_TEXELS
) -> dict[str, Any]:
    """The result for a mesh."""
    with mesh_file(mesh) as path:
        asset = prepare(path, PreprocessOptions(texels=texels), every_rung=True)
    gpu = Gpu(1024)
    try:
        gpu.gl.most_samples = min(samples, int(gpu.ctx.max_samples))
        result = {"mesh": Path(mesh).name, "faces": len(asset.faces)} | measured(gpu, asset, size, views)
        if stencil_views:
            result["stencil"] = stencil_error(gpu, asset, size, stencil_views)
    finally:
        gpu.release()
    return result | {"bars": list(bars(result))}


def measured(gpu: Gpu, asset: MeshAsset, size: int, views: int) -> dict[str, Any]:
    """The rungs of an asset in pictures of one size."""
    return as_result(gpu, ladder_of(gpu, asset, size, views), size, views)


def ladder_of(gpu: Gpu, asset: MeshAsset, size: int, views: int) -> Ladder:
    """The ladder of an asset in pictures of one size."""
    todo = steps(views, (size,))
    return put_together(asset, gpu.costs.device, [measure_step(gpu, asset, step, views, first=step == todo[0]) for step in todo], views)


def as_result(gpu: Gpu, ladder: Ladder, size: int, views: int) -> dict[str, Any]:
    """A ladder of one size, flat."""
    return {
        "device": ladder.device,
        "size": size,
        "views": views,
        "reference_samples": SAMPLES**2,
        "msaa_samples": gpu.gl.most_samples,
        "rungs": [rung_line(rung) for rung in ladder.rungs],
    }


def rung_line(rung: MeasuredRung) -> dict[str, Any]:
    """A rung and what was measured of it, flat."""
    at = rung.sizes[0]
    return rung.model_dump(mode="json", include={"source", "antialias", "level", "hull_faces", "texels", "level_faces"}) | {
        "alpha_error": at.outline.alpha_error,
        "alpha_rmse": at.outline.alpha_rmse,
        "wrong_pixels": at.outline.wrong_pixels,
        "distance_px": at.outline.distance_px,
        "psnr": at.shading.psnr_db,
        "ssim": at.shading.ssim,
        "ms": at.frame.p50_ms,
        "bound_px": at.bound_px,
    }


def stencil_error(gpu: Gpu, asset: MeshAsset, size: int, views: int) -> dict[str, Any]:
    """By how many pixels the stencil's mask differs from the original's, as parts of all pixels: in the worst view, and in all."""

    def inside(camera: AnyCamera, source: Source) -> Array:
        accuracy = Accuracy(source=source, antialias=Antialias.NONE)
        wanted = RenderRequest(camera=camera, width=size, height=size, accuracy=accuracy, shading=Shading(mode=ShadingMode.MASK))
        return render_frame(gpu, asset, wanted).pixels[:, :, 3] > 127

    cameras = [spread_view(view, views) for view in range(views)]
    wrong = [int((inside(camera, Source.CLIPPED) != inside(camera, Source.ORIGINAL)).sum()) for camera in cameras]
    return {"views": views, "pixels": sum(wrong), "worst": max(wrong) / size**2, "total": sum(wrong) / (views * size**2)}


def bars(result: dict[str, Any]) -> Iterator[dict[str, Any]]:
    """What is demanded of the exact outlines, and whether it is reached."""
    own = {(rung["source"], rung["antialias"]): rung for rung in result["rungs"] if rung["level"] is None}
    coverage, line, msaa = (
        own[Source.CLIPPED, Antialias.COVERAGE],
        own[Source.CLIPPED, Antialias.LINE],
        own[Source.ORIGINAL, Antialias.MSAA],
    )
    demands = [
        ("coverage alpha error", coverage["alpha_error"], COVERAGE_ERROR),
        ("coverage alpha error, a third of msaa's", coverage["alpha_error"], PART_OF_MSAA * msaa["alpha_error"]),
        ("coverage alpha rmse", coverage["alpha_rmse"], COVERAGE_RMSE),
        ("line alpha error", line["alpha_error"], LINE_ERROR),
    ]
    if "stencil" in result:
        demands.append(("stencil, part of pixels that differ, worst view", result["stencil"]["worst"], STENCIL_PART))
    for name, value, most in demands:
        yield {"name": name, "value": value, "most": most, "met": value <= most}


def print_table(result: dict[str, Any]) -> None:
    print(f"{result['mesh']}: {result['faces']} faces, {result['size']} px, {result['views']} views, {result['device']}")
    print(f"  {'rung':<58} {'alpha':>7} {'rmse':>7} {'wrong':>7} {'px':>6} {'dB':>5} {'ssim':>6} {'bound':>7} {'ms':>7}")
    for rung in result["rungs"]:
        bound = "" if rung["bound_px"] is None else f"{rung['bound_px']:.3f}"
        print(
            f"  {name_of(rung):<58} {rung['alpha_error']:>7.4f} {rung['alpha_rmse']:>7.4f} {rung['wrong_pixels']:>7.1f} "
            f"{rung['distance_px']:>6.2f} {rung['psnr']:>5.1f} {rung['ssim']:>6.3f} {bound:>7} {rung['ms']:>7.2f}"
        )
    if "stencil" in result:
        stencil = result["stencil"]
        print(
            f"  stencil: {stencil['pixels']} pixels in {stencil['views']} views, worst {stencil['worst']:.2e}, all {stencil['total']:.2e}"
        )
    for bar in result["bars"]:
        print(f"  {'met' if bar['met'] else 'MISSED'}: {bar['name']}: {bar['value']:.3g}, at most {bar['most']:.3g}")


def name_of(rung: dict[str, Any]) -> str:
    """As `RungKey.label`, with the faces of the level."""
    parts = [f"{rung['source']}/{rung['antialias']}"]
    parts += [] if rung["level"] is None else [f"outline of {rung['level_faces']}"]
    parts += [] if rung["hull_faces"] is None else [f"hull {rung['hull_faces']}", f"{rung['texels']} texels"]
    return ", ".join(parts)


def main() -> None:
    parser = mesh_parser(__doc__ or "")
    parser.add_argument("--size", type=int, default=512, help="pixels along each side")
    parser.add_argument("--views", type=int, default=VIEWS)
    parser.add_argument("--samples", type=int, default=MSAA_SAMPLES, help="of the rung msaa in a pixel, at most the driver's most")
    parser.add_argument("--stencil", type=int, default=0, metavar="VIEWS", help="compare the stencil's mask in so many views")
    parser.add_argument("--texels", type=int, default=DEFAULT_TEXELS, help="along each side of the largest maps")
    options = parser.parse_args()
    sizes = (options.size, options.views, options.samples, options.stencil, options.texels)
    report(lambda: run(options.mesh, *sizes), options.json, print_table)


if __name__ == "__main__":
    main()
