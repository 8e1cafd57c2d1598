"""Figure 10 of Silhouette Clipping: the original, a simplified normal-mapped mesh, and a clipped hull of as many faces.

    python -m benchmarks.tables.figure10 [MESH ...] [--quick] [--json] [--out DIR]

The simplified mesh is made by quadrics, with no regard to enclosure; its normal map is shot from its surface moved outwards far
enough to see the whole original, and it is drawn with exact coverage of its own outline: its best. All are compared with the
original supersampled 8 x 8 and averaged in linear light.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from benchmarks import frame
from benchmarks.models import mesh_file
from benchmarks.report import Result, markdown_table, number
from benchmarks.rivals import simplified
from benchmarks.tables.making import Table, main
from geometry.boxes import build_boxes
from geometry.topology import build_edges, vertex_normals
from schemas.conventions import F4, F8, I4, U1
from schemas.mesh import PreprocessOptions
from schemas.render import MAX_SIDE_PX, Accuracy, Antialias, Orbit, OrbitCamera, RenderRequest, Source
from service.assets import MeshAsset
from service.measure.views import GOLDEN_DEG
from service.render.frame import render_frame
from service.render.state import Gpu
from service.silhouette.extract import SilhouetteTree
from worker.bake import bake_maps, hull_normals
from worker.kernels import bake_boxes
from worker.tree import build_tree

FACES, TEXELS = 500, 1024
SIDE_PX, SAMPLES, VIEWS = 512, 8, 10
DISTANCE = 2.75
"""Radii from the centre to the eye: the bounding sphere fills the 45 degrees of the picture."""
DETAIL_PX = 96
COVERAGE, STENCIL = (Source.CLIPPED, Antialias.COVERAGE), (Source.CLIPPED, Antialias.NONE)
DRAWN = {
    "original, no antialiasing": ("original", (Source.ORIGINAL, Antialias.NONE)),
    "original, 4x MSAA": ("original", (Source.ORIGINAL, Antialias.MSAA)),
    "simplified, normal-mapped": ("simplified", COVERAGE),
    "clipped hull, no antialiasing": ("original", STENCIL),
    "clipped hull, exact coverage": ("original", COVERAGE),
}
"""What is compared: which asset on which rung."""
_STEPS = np.arange(256) / 255.0
LINEAR = np.where(_STEPS <= 0.04045, _STEPS / 12.92, ((_STEPS + 0.055) / 1.055) ** 2.4)
"""(256,) f8 linear light of sRGB bytes."""
STRIP = ("simplified, normal-mapped", "clipped hull, exact coverage")


def measure(mesh: str, quick: bool, texels: int = TEXELS) -> Result:
    """{faces, coarse_faces, size, views, drawn: {label: errors}, pictures}."""
    with mesh_file(mesh) as path:
        original = frame.prepare(path, PreprocessOptions(hull_faces=FACES, texels=texels))
    assets = {"original": original, "simplified": unconstrained(original, FACES, texels)}
    gpu = Gpu(1024)
    errors: dict[str, list[tuple[float, float]]] = {label: [] for label in DRAWN}
    try:
        views = 2 if quick else VIEWS
        for view in range(views):
            wanted = reference(gpu, original, camera(view, views, original))
            for label, (asset, rung) in DRAWN.items():
                errors[label].append(differences(picture(gpu, assets[asset], camera(view, views, original), rung), wanted))
        pictures = _pictures(gpu, assets, camera(0, 1, original))
    finally:
        gpu.release()
    means = {label: np.mean(found, axis=0).round(3).tolist() for label, found in errors.items()}
    drawn = {label: {"outline_px": outline, "shading_rms": shading} for label, (outline, shading) in means.items()}
    facts = {"faces": len(original.faces), "coarse_faces": FACES, "size": SIDE_PX, "views": views}
    return facts | {"drawn": drawn, "pictures": pictures}


def unconstrained(original: MeshAsset, count: int, texels: int) -> MeshAsset:
    """The original simplified by quadrics, its silhouette its own, with a map of the original's normals."""
    positions, faces = simplified(original.positions, original.faces, count)
    edges = build_edges(faces)
    outside = _moved_out(positions, faces, original.positions)
    maps = bake_maps(
        outside,
        faces,
        hull_normals(outside, faces),
        *(original.positions, original.faces, original.normals, original.appearance),
        texels,
        frame.silent,
        corner_normals=original.corner_normals,
    )
    tensors = {"positions": positions, "faces": faces, "edge_vertices": edges.vertices, "edge_faces": edges.faces}
    tree = build_tree(positions, faces, edges.vertices, edges.faces, frame.silent)
    return replace(
        original,
        id=f"{original.id} simplified",
        positions=positions,
        faces=faces,
        normals=vertex_normals(positions, faces),
        appearance=None,
        edges=(edges.vertices, edges.faces),
        hull={"positions": positions, "faces": faces, "normals": hull_normals(positions, faces)},
        maps={"tile_uv": maps.tile_uv, "normal": maps.normal},
        tree=SilhouetteTree(tensors, tree.tensors()),
        normal_vertices=None,
        corner_normals=None,
    )


def _moved_out(positions: F4, faces: I4, original: F4) -> F4:
    """Vertices moved along their normals by twice the largest distance of the original from the mesh."""
    order, boxes = build_boxes(positions, faces)
    _, _, square = bake_boxes.closest_points(positions, faces, order, boxes, original.astype(np.float64))
    return (positions + 2.0 * np.sqrt(square.max()) * vertex_normals(positions, faces)).astype(np.float32)


def camera(view: int, views: int, asset: MeshAsset) -> OrbitCamera:
    """One of `views` cameras spread evenly over the sphere, at one distance whatever is drawn."""
    elevation = float(np.degrees(np.arcsin(1.0 - 2.0 * (view + 0.5) / views)))
    turned = (25.0 + view * GOLDEN_DEG) % 360.0
    return OrbitCamera(orbit=Orbit(azimuth_deg=turned, elevation_deg=elevation, distance=DISTANCE * asset.frame.scale))


def picture(gpu: Gpu, asset: MeshAsset, seen: OrbitCamera, rung: tuple[Source, Antialias], side: int = SIDE_PX) -> U1:
    """(side, side, 4) u1 sRGB, straight alpha."""
    accuracy = Accuracy(source=rung[0], antialias=rung[1])
    return render_frame(gpu, asset, RenderRequest(camera=seen, width=side, height=side, accuracy=accuracy)).pixels


def reference(gpu: Gpu, asset: MeshAsset, seen: OrbitCamera) -> F8:
    """(s, s, 4) f8 linear light, premultiplied: the original at SAMPLES x SAMPLES the pixels, averaged."""
    samples = min(SAMPLES, MAX_SIDE_PX // SIDE_PX)
    large = linear(picture(gpu, asset, seen, (Source.ORIGINAL, Antialias.NONE), SIDE_PX * samples))
    return large.reshape(SIDE_PX, samples, SIDE_PX, samples, 4).mean(axis=(1, 3))


def linear(pixels: U1) -> F8:
    """(h, w, 4) f8 linear light, premultiplied, of sRGB bytes with straight alpha."""
    alpha = pixels[..., 3:] / 255.0
    return np.concatenate([LINEAR[pixels[..., :3]] * alpha, alpha], axis=-1)


def differences(made: U1, wanted: F8) -> tuple[float, float]:
    """(area of the image that is covered wrongly, pixels; root mean square of colour, sRGB steps, where both are opaque)."""
    ours = linear(made)
    area = float(np.abs(ours[..., 3] - wanted[..., 3]).sum())
    opaque = (ours[..., 3] > 0.999) & (wanted[..., 3] > 0.999)
    steps = encoded(ours[opaque][:, :3]) - encoded(wanted[opaque][:, :3])
    return area, float(np.sqrt((steps**2).mean())) if opaque.any() else 0.0


def encoded(light: F8) -> F8:
    """sRGB, 0 to 255, of linear light."""
    light = np.clip(light, 0.0, 1.0)
    return 255.0 * np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1.0 / 2.4) - 0.055)


def _pictures(gpu: Gpu, assets: dict[str, MeshAsset], seen: OrbitCamera) -> dict[str, F8]:
    """The reference and the two of STRIP: (s, s, 4) f8 linear light, premultiplied."""
    pictures = {"original": reference(gpu, assets["original"], seen)}
    for label in STRIP:
        asset, rung = DRAWN[label]
        pictures[label] = linear(picture(gpu, assets[asset], seen, rung))
    return pictures


def over_white(light: F8) -> U1:
    """(h, w, 3) u1 sRGB of premultiplied linear light on white."""
    return np.round(encoded(light[..., :3] + (1.0 - light[..., 3:]))).astype(np.uint8)


def worst_window(wrong: F8, side: int) -> tuple[int, int]:
    """(row, column) of the window of side x side pixels with the largest sum."""
    sums = np.pad(wrong, ((1, 0), (1, 0))).cumsum(axis=0).cumsum(axis=1)
    windows = sums[side:, side:] - sums[:-side, side:] - sums[side:, :-side] + sums[:-side, :-side]
    row, column = np.unravel_index(windows.argmax(), windows.shape)
    return int(row), int(column)


def text(result: Result) -> str:
    """The errors of each mesh."""
    parts = []
    for name, row in result["meshes"].items():
        lines = [[label, number(errors["outline_px"]), number(errors["shading_rms"])] for label, errors in row["drawn"].items()]
        parts.append(EXPLAINED.format(name=name, **row))
        parts.append(markdown_table(["drawn", "outline: pixels covered wrongly", "shading: RMS, of 255"], lines))
    return "\n\n".join(parts)


EXPLAINED = """\
{name}, {faces:,} faces; simplified and hull: {coarse_faces}. {size} x {size}, means over {views} views, against the original
supersampled 8 x 8. The outline's error is the sum over all pixels of how much of each is covered wrongly; the shading's is over
pixels that both cover wholly."""


def plot(result: Result, folder: Path) -> list[str]:
    """The three pictures, and below each the place where the simplified outline is worst."""
    from matplotlib import pyplot
    from matplotlib.patches import Rectangle

    from benchmarks.tables.plots import COLORS, save

    names = []
    for name, row in result["meshes"].items():
        figure, grid = pyplot.subplots(2, 3, figsize=(10.0, 7.4), layout="constrained")
        pictures = row["pictures"]
        top, left = worst_window(np.abs(pictures[STRIP[0]][..., 3] - pictures["original"][..., 3]), DETAIL_PX)
        for column, (label, light) in enumerate(pictures.items()):
            pixels = over_white(light)
            whole, detail = grid[:, column]
            whole.imshow(pixels, interpolation="nearest")
            whole.add_patch(Rectangle((left, top), DETAIL_PX, DETAIL_PX, fill=False, edgecolor=COLORS[2], linewidth=1.5))
            detail.imshow(pixels[top : top + DETAIL_PX, left : left + DETAIL_PX], interpolation="nearest")
            whole.set_title(_caption(label, row), fontsize=10)
            for panel in (whole, detail):
                panel.set_xticks([])
                panel.set_yticks([])
        names.append("figure10.png" if len(result["meshes"]) == 1 else f"figure10_{name}.png")
        save(figure, folder / names[-1])
    return names


def _caption(label: str, row: Result) -> str:
    if label == "original":
        return f"original, {row['faces']:,} faces\nsupersampled"
    errors = row["drawn"][label]
    return f"{label}, {row['coarse_faces']} faces\noutline {errors['outline_px']:.0f} px wrong, shading {errors['shading_rms']:.1f} of 255"


TABLE = Table("figure10", "Figure 10: image quality", ("bunny_closed",), measure, text, plot)

if __name__ == "__main__":
    main(TABLE)
