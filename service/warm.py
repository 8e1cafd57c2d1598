"""The first picture of a process compiles kernels and shaders; this draws it before anybody asks.

An octahedron goes through the same artifact files and the same renderer as an upload, so that exactly the code that requests
run is made ready, with the very array types they have.
"""

from __future__ import annotations

import logging
import sys
import tempfile
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import CancelledError
from dataclasses import replace
from datetime import UTC, datetime
from functools import partial
from pathlib import Path

import numpy as np

from backend.artifacts import identity_of, write_artifact
from backend.local_store import LocalStore
from backend.store import Store
from geometry.tile_layout import TileLayout
from geometry.topology import build_edges
from schemas import artifacts
from schemas.artifacts import Layout
from schemas.conventions import Array
from schemas.errors import SilhouetteError
from schemas.lines import LineKind, LineMethod, Lines, Stroke
from schemas.manifest import FrameRecord, Manifest, StageRecord
from schemas.mesh import Capability
from schemas.render import (
    Accuracy,
    Antialias,
    Camera,
    Orbit,
    OrbitCamera,
    ProjectTo,
    RenderRequest,
    Shading,
    ShadingMode,
    SilhouetteRequest,
    Source,
)
from schemas.scene import Parts, SceneObject, SceneRequest
from service.assets import MeshAsset, load_asset
from service.camera import resolve_camera
from service.hulls import Side, hull_file
from service.moving import Moving
from service.render.calibration import calibrate
from service.render.edge_mesh import find_edges
from service.render.renderer import Renderer
from service.scene.draw import drawing_of
from service.scene.plan import plan_scene
from service.silhouette.describe import describe_silhouette
from service.silhouette.document import silhouette_binary, silhouette_dxf, silhouette_json, silhouette_svg
from service.silhouette.project import project_loops
from service.waiting import Stopwatch

log = logging.getLogger("silhouette.service")

BACKWARDS_FLAG = "--backwards"

MESH_ID = "0" * 32
SIDE_PX = 64
MAP_TEXELS = 64
HULL_SIZE = 1.1
"""The hull is so much larger than the octahedron."""

WHOLE = OrbitCamera(orbit=Orbit(azimuth_deg=30.0, elevation_deg=20.0))
BESIDE = Camera(eye=[0.75, 0.75, 0.1], target=[0.5, 0.5, 1.0], fov_y_deg=150.0)
"""Looks past the octahedron, part of which is behind the eye: its contour is cut at the eye plane and closed there."""
BEHIND = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 1.0], [1.0, 1.0, -1.0]])
"""A curve that leaves the image through the eye plane; those of the octahedron do not."""
INSIDE = Camera(eye=[0.1, 0.2, 0.3])
"""Has layers all round it, which no contour knows of: they are counted on the faces."""

WAYS = (
    (Source.CLIPPED, Antialias.COVERAGE),
    (Source.ORIGINAL, Antialias.MSAA),
    (Source.CLIPPED, Antialias.LINE),
    (Source.CLIPPED, Antialias.NONE),
    (Source.ORIGINAL, Antialias.NONE),
)
"""What is drawn, the commonest first: it may be asked for before the others are done."""


def warm_in_background(renderer: Renderer) -> None:
    """Warm and calibrate in a thread that ends with the process at the latest."""

    def both() -> None:
        warm(renderer)
        calibrate_costs(renderer)

    threading.Thread(target=both, name="warm", daemon=True).start()


def calibrate_costs(renderer: Renderer) -> None:
    """Find what this device takes; where it is too busy for that, frames are predicted from nominal costs and what they take."""
    clock = Stopwatch()
    try:
        renderer.costs.recalibrate(calibrate(renderer.submit))
    except (SilhouetteError, CancelledError) as error:
        log.info("not calibrated: %s", error)
    else:
        log.info("calibrated", extra={"device": renderer.costs.device, "seconds": round(clock.ms() / 1e3, 2)})


def warm(renderer: Renderer, *, backwards: bool = False) -> None:
    """Draw and describe an octahedron in every common way; backwards: the last way first."""
    clock = Stopwatch()
    try:
        with tempfile.TemporaryDirectory(prefix="silhouette-warm-") as folder:
            store = LocalStore(Path(folder))
            steps = _steps(renderer, store, octahedron(store))
            for step in reversed(steps) if backwards else steps:
                step()
    except (SilhouetteError, CancelledError) as error:  # busy already, or closing: then requests do the warming
        log.info("not warmed: %s", error)
    else:
        log.info("warmed", extra={"seconds": round(clock.ms() / 1e3, 2)})


def _steps(renderer: Renderer, store: Store, asset: MeshAsset) -> Sequence[Callable[[], object]]:
    """What warms, in order; each goes without those before it."""
    return (
        partial(_draw, renderer, asset),
        partial(_draw_lines, renderer, asset),
        partial(_extract_together, asset),
        partial(_draw_scenes, renderer, asset),
        partial(_describe, asset),
        partial(_describe_lines, asset),
        partial(_move, renderer, asset),
        partial(hull_file, store, asset, Side.OUTER, len(asset.faces)),
    )


def _draw(renderer: Renderer, asset: MeshAsset) -> None:
    for request in _requests():
        renderer.submit(asset, request).result()


def _draw_lines(renderer: Renderer, asset: MeshAsset) -> None:
    """On the closed octahedron and on what is left of it without its edges."""
    loose = replace(asset, id="loose", edges=None, hull=None, maps=None, tree=None)
    for request in _line_requests():
        for one in (asset, loose):
            renderer.submit(one, request).result()
    for edges in (asset.edges, None):
        find_edges(asset.positions, asset.faces, edges)


def _draw_scenes(renderer: Renderer, asset: MeshAsset) -> None:
    for scene in _scenes():
        renderer.submit_drawing(drawing_of(plan_scene(scene, [asset] * len(scene.objects)))).result()


def _describe(asset: MeshAsset) -> None:
    """From outside, beside and inside."""
    project_loops(resolve_camera(BESIDE, asset.frame, SIDE_PX, SIDE_PX), BEHIND, np.array([0, len(BEHIND)], np.int32))
    for camera in (WHOLE, BESIDE, INSIDE):
        for smooth in (False, True):
            described = describe_silhouette(asset, SilhouetteRequest(camera=camera, project=ProjectTo(), smooth=smooth))
            for write in (silhouette_json, silhouette_svg, silhouette_binary):
                write(described)


def _move(renderer: Renderer, asset: MeshAsset) -> None:
    """The octahedron with its vertices moved: drawn, without lines and with, and described without a tree."""
    moved = Moving(asset).at(asset.frame.to_model(asset.positions))
    for request in (RenderRequest(width=SIDE_PX, height=SIDE_PX), *_line_requests()):
        renderer.submit_once(moved, request).result()
    describe_silhouette(moved, SilhouetteRequest(camera=INSIDE, project=ProjectTo()))
    _describe_lines(moved)


def _describe_lines(asset: MeshAsset) -> None:
    """Lines of every kind from outside, written down in every way, and with fewer points and round corners."""
    for camera in (WHOLE, BESIDE):
        for tolerance in (None, 0.5):
            wanted = SilhouetteRequest(
                camera=camera, project=ProjectTo(), kinds=list(LineKind), simplify_px=tolerance, smooth_px=tolerance, visible_only=True
            )
            described = describe_silhouette(asset, wanted)
            for write in (silhouette_json, silhouette_svg, silhouette_binary, silhouette_dxf):
                write(described)
    stroke = Stroke(width_by="angle", opacity_by="curvature", dash=[6.0, 4.0], wobble_px=2.0)
    silhouette_svg(describe_silhouette(asset, SilhouetteRequest(project=ProjectTo(), kinds=list(LineKind), stroke=stroke)))


def _extract_together(asset: MeshAsset) -> None:
    """Several eyes in one call, and one eye on several threads."""
    assert asset.tree is not None
    eyes = np.array([[2.0, 1.0, 1.0, 1.0], [0.0, 0.0, 1.0, 0.0]])
    asset.tree.extract_many(eyes)
    asset.tree.share_leaves(eyes[0], threads=2)


def _requests() -> Iterator[RenderRequest]:
    yield RenderRequest(width=1, height=1)  # the whole outline in one pixel, which then is resolved exactly
    for source, antialias in WAYS:
        yield RenderRequest(width=SIDE_PX, height=SIDE_PX, accuracy=Accuracy(source=source, antialias=antialias))
    yield RenderRequest(width=SIDE_PX, height=SIDE_PX, shading=Shading(mode=ShadingMode.MASK))
    yield RenderRequest(width=SIDE_PX, height=SIDE_PX, accuracy=Accuracy(smooth=True))
    for antialias in (Antialias.COVERAGE, Antialias.LINE):
        yield RenderRequest(camera=BESIDE, width=SIDE_PX, height=SIDE_PX, accuracy=Accuracy(source=Source.CLIPPED, antialias=antialias))


def _line_requests() -> Iterator[RenderRequest]:
    """Every kernel that lines take, with faces that are trusted and with faces that are looked for."""
    sharp = {"ridge": {}, "valley": {}, "ridge_deg": 1.0, "valley_deg": 1.0}
    for lines in (
        {"method": "translated", "orientation": "any"},
        {"method": "wireframe", **sharp},
        {"method": "fattened", "charcoal": True},
        {"method": "strokes", "stroke": {"opacity_by": "depth"}},
    ):
        yield RenderRequest(width=SIDE_PX, height=SIDE_PX, lines=Lines.model_validate(lines))


def _scenes() -> Iterator[SceneRequest]:
    """Two that overlap in the picture, two that touch, and two that interlock; one of them stretched and mirrored. The last with lines."""
    sharp = {"ridge": {}, "ridge_deg": 1.0}
    for shift in ([0.2, 0.1, -3.0], [1.0, 0.0, -1.0], [0.5, 0.3, 0.0]):
        other = SceneObject(mesh=MESH_ID, transform=Parts(translate=shift, scale=[-1.0, 1.0, 0.8]))
        yield SceneRequest(width=SIDE_PX, height=SIDE_PX, background="#102030", objects=[SceneObject(mesh=MESH_ID), other])
    for method in (LineMethod.EDGE_MESH, LineMethod.WIREFRAME):
        lined = other.model_copy(update={"lines": Lines.model_validate({"method": method, **sharp})})
        yield SceneRequest(width=SIDE_PX, height=SIDE_PX, objects=[SceneObject(mesh=MESH_ID), lined], lines=Lines.model_validate(sharp))


def octahedron(store: Store) -> MeshAsset:
    """A clippable asset of eight faces, stored in and mapped from `store`."""
    positions = np.concatenate([np.eye(3), -np.eye(3)]).astype(np.float32)
    faces = np.array([[0, 1, 2], [1, 3, 2], [3, 4, 2], [4, 0, 2], [1, 0, 5], [3, 1, 5], [4, 3, 5], [0, 4, 5]], np.int32)
    edges = build_edges(faces)
    count = len(edges.vertices)
    one_node: dict[str, Array] = {"scaled_normal": np.zeros((1, 3), np.float32), "front_anchor": np.zeros((1, 3), np.float32)}
    one_node |= {"back_anchor": np.zeros((1, 3), np.float32), "separation": np.zeros(1, np.float32)}
    order: dict[str, Array] = {
        "skip": np.array([1], np.int32),
        "edge_start": np.array([0, count], np.int32),
        "edge_index": np.arange(count, dtype=np.int32),
    }
    tiles = TileLayout.fitting(len(faces), MAP_TEXELS)
    texels = (tiles.height, tiles.width)
    colors = np.full((*texels, 4), 255, np.uint8)
    maps = {"tile_uv": tiles.tile_uv(np.zeros(len(faces), np.int32)), "normal": np.full((*texels, 3), 200, np.uint8), "color": colors}
    hull = {"positions": positions * np.float32(HULL_SIZE), "faces": faces, "normals": positions}
    none = np.zeros(0, np.int32)
    unshrunk: dict[str, Array] = {"step_vertices": np.zeros((0, 2), np.int32), "step_positions": np.zeros((0, 3), np.float32)}
    unshrunk |= {"level_faces": none, "level_steps": none}
    files: list[tuple[Layout, Mapping[str, Array]]] = [
        (
            artifacts.MESH,
            {"positions": positions, "faces": faces, "normals": positions, "edge_vertices": edges.vertices, "edge_faces": edges.faces},
        ),
        (artifacts.HULL, hull),
        (artifacts.MAPS, maps),
        (artifacts.HULL_SEQUENCE, unshrunk),
        (artifacts.TREE, one_node | order),
    ]
    made = {layout.file: write_artifact(store, MESH_ID, layout, tensors, identity_of(MESH_ID, "warm")) for layout, tensors in files}
    manifest = Manifest(
        id=MESH_ID,
        status="ready",
        frame=FrameRecord(centre=(0.0, 0.0, 0.0), scale=1.0),
        capabilities={"clip": Capability(available=True)},
        stages=[StageRecord(stage="warm", outcome="done", seconds=0.0, artifacts=made)],
        finished=datetime.now(UTC),
    )
    return load_asset(store, manifest)


def main() -> None:
    """Warm in a process of its own, so that numba's cache on disk has everything. Raises EglUnavailableError.

    `--backwards`: for a second process beside the first, which meet where each finds what the other has compiled.
    """
    renderer = Renderer()
    renderer.start()
    try:
        warm(renderer, backwards=BACKWARDS_FLAG in sys.argv[1:])
    finally:
        renderer.close()


if __name__ == "__main__":
    main()
