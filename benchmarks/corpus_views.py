"""Is a ready mesh right from wherever one can stand? Its silhouettes, its hull and its pictures against slow references."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from backend import records
from backend.local_store import LocalStore
from backend.settings import BackendSettings
from geometry.silhouettes import silhouette_scalar
from schemas.conventions import F8, I4, U1, Array
from schemas.errors import SilhouetteError
from schemas.render import Accuracy, Antialias, Camera, RenderRequest, Source
from service.assets import MeshAsset, load_asset
from service.camera import resolve_camera
from service.measure.errors import shading_error, shading_of
from service.measure.reference import reference
from service.render.frame import render_frame
from service.render.state import Gpu
from tests.eye_cases import awkward
from tests.oracles_hull import NEIGHBOURHOOD, surface_points, uncovered, winding_numbers

Values = dict[str, Any]
VIEWS, SIDE_PX = 24, 256
SEED = 7
NEAREST, FARTHEST = 1.5, 4.0  # radii
CLOSE = 0.02  # radii above a face, for eyes that nearly touch it
VERTICES, SURFACE_POINTS = 20_000, 4_000
LOOKED_INTO, BALL_POINTS = 64, 512
"""Points that seem to be outside a hull and are looked into, and how many points about each of them are."""
CACHE_MIB = 1024
EXACT = "clipped/coverage"
"""The rung whose outline is exact."""
WRONG = 0.25
"""Error of alpha beyond all that 16 x 16 samples of a pixel can miss of anything but slivers."""
EYE_KINDS = (
    "around",
    "around",
    "orthographic",
    "around",
    "close",
    "around",
    "inside",
    "around",
    "around",
    "vertex",
    "orthographic",
    "plane",
)
"""What the views are in turn; of 24 twelve are around, four orthographic and two of each other kind."""


def measure_views(data_dir: Path, mesh_id: str, views: int = VIEWS, side: int = SIDE_PX) -> Values:
    """What a ready mesh in a data folder gets wrong, from so many views. Makes a GL context: to be run in a process of its own.

    mismatches: eyes, of `eyes` of them, whose edges by the tree differ from the brute force as sets; unbalanced: eyes with a vertex that
    more edges enter than leave; None without a tree. enclosed: whether no vertex and no sampled point of the surface is outside the hull,
    None without a hull. bad_pictures: of the wrong size or type. mask_error: mean over the views of the picture's error of alpha, over the
    pixels that either covers in part or that differ, where the exact mask made the outline; mask_error_worst: of one view; wrong_pixels: of
    those pictures, off by more than WRONG; largest_error: of any of their pixels; original_error: as mask_error, of pictures that the mesh
    itself made the outline of. psnr_db: of sRGB bytes where both cover fully, over all views; psnr_db_worst: of one. refused_views: what
    views were refused for.
    Raises RuntimeError when the GL reports an error.
    """
    store = LocalStore(BackendSettings(data_dir=data_dir).store_dir)
    manifest = records.read_manifest(store, mesh_id)
    assert manifest is not None and manifest.status == "ready"
    asset = load_asset(store, manifest)
    cameras = cameras_of(asset, views)
    return {"views": len(cameras)} | silhouettes(asset, cameras, side) | enclosure(asset) | pictures(asset, cameras, side)


def cameras_of(asset: MeshAsset, views: int) -> list[Camera]:
    """Seeded cameras, by EYE_KINDS in turn: the same for a mesh in every run.

    Fewer for a mesh so far from the origin of its coordinates that eye and target are the same numbers there.
    """
    rng = np.random.default_rng(SEED)
    found = (_camera(asset, EYE_KINDS[number % len(EYE_KINDS)], rng) for number in range(views))
    return [camera for camera in found if camera is not None]


def _camera(asset: MeshAsset, kind: str, rng: np.random.Generator) -> Camera | None:
    around = rng.normal(size=3)
    around /= np.linalg.norm(around)
    eye, target = around * rng.uniform(NEAREST, FARTHEST), rng.uniform(-0.2, 0.2, 3)
    a, b, c = asset.positions[asset.faces[rng.integers(len(asset.faces))]].astype(np.float64)
    if kind == "close":
        across = np.cross(b - a, c - a)
        eye, target = (a + b + c) / 3.0 + CLOSE * across / max(np.linalg.norm(across), 1e-300), (a + b + c) / 3.0
    elif kind == "inside":
        eye = rng.uniform(-0.2, 0.2, 3)
        target = a
    elif kind == "vertex":
        eye = a
    elif kind == "plane":
        eye = a + 2.0 * (b - a) + 3.0 * (c - a) if rng.integers(2) else a + 1.5 * NEAREST * _unit(b - a)
    up = around[[1, 2, 0]] - around[[2, 0, 1]]
    model = asset.frame.to_model(np.stack([eye, target])).tolist()
    flat = {"projection": "orthographic", "height": 2.2 * asset.frame.scale} if kind == "orthographic" else {}
    fov_y_deg = float(rng.uniform(30.0, 60.0))
    return None if model[0] == model[1] else Camera(eye=model[0], target=model[1], up=up.tolist(), fov_y_deg=fov_y_deg, **flat)


def _unit(vector: F8) -> F8:
    return np.asarray(vector / max(float(np.linalg.norm(vector)), 1e-300))


def silhouettes(asset: MeshAsset, cameras: list[Camera], side: int) -> Values:
    """The tree against the brute force: for the eyes of the cameras, and for those of `tests.eye_cases.awkward`."""
    if asset.tree is None or asset.edges is None:
        return {"eyes": 0, "mismatches": None, "unbalanced": None}
    eyes = [resolve_camera(camera, asset.frame, side, side, asset.radius).eye for camera in cameras]
    eyes += awkward(asset.positions, asset.faces).values()
    mismatches = unbalanced = 0
    for eye in eyes:
        found = asset.tree.extract(eye).edges
        exact = silhouette_scalar(asset.positions, asset.faces, *asset.edges, eye)
        mismatches += not np.array_equal(in_order(found), in_order(exact))
        entered, left = (np.bincount(found[:, end], minlength=len(asset.positions)) for end in (1, 0))
        unbalanced += not np.array_equal(entered, left)
    return {"eyes": len(eyes), "mismatches": mismatches, "unbalanced": unbalanced}


def in_order(edges: I4) -> I4:
    """(s, 2) directed edges sorted: two sets are the same when these are, and an edge that comes twice makes them differ."""
    return np.asarray(edges[np.lexsort(edges.T)])


def enclosure(asset: MeshAsset, samples: int = SURFACE_POINTS) -> Values:
    """Whether the hull holds the mesh, by winding numbers. outside: points that it does not, LOOKED_INTO at most."""
    if asset.hull is None:
        return {"enclosed": None, "outside": None}
    rng = np.random.default_rng(SEED)
    chosen = rng.permutation(len(asset.positions))[:VERTICES]
    points = np.concatenate([asset.positions[chosen].astype(np.float64), surface_points(asset.positions, asset.faces, samples)])
    original, hull = (asset.positions, asset.faces), (asset.hull["positions"], asset.hull["faces"])
    found = points[uncovered(*original, *hull, points)][:LOOKED_INTO]
    balls = found[:, None] + rng.normal(size=(len(found), BALL_POINTS, 3)) * NEIGHBOURHOOD
    outside = sum(lacks_interior(original, hull, ball) for ball in balls)
    return {"enclosed": outside == 0, "outside": outside}


def lacks_interior(original: tuple[Array, Array], hull: tuple[Array, Array], points: F8) -> bool:
    """Whether some of the (n, 3) points are inside the original and not inside its hull.

    Where a surface crosses itself that tells a point that the hull leaves out from one beside another sheet, whose interior the hull has.
    """
    return bool(((winding_numbers(*original, points) > 0.5) & (winding_numbers(*hull, points) < 0.5)).any())


def pictures(asset: MeshAsset, cameras: list[Camera], side: int) -> Values:
    """Pictures against the mesh at 16 x 16 samples a pixel."""
    gpu = Gpu(CACHE_MIB)
    errors: dict[bool, list[float]] = {True: [], False: []}
    shading, wrong, largest = [], 0, 0.0
    refused: list[str] = []
    bad = 0
    source = Source.AUTO if asset.clippable else Source.ORIGINAL
    try:
        for camera in cameras:
            accuracy = Accuracy(source=source, antialias=Antialias.COVERAGE)
            try:
                made = render_frame(gpu, asset, RenderRequest(camera=camera, width=side, height=side, accuracy=accuracy))
            except SilhouetteError as error:
                refused.append(error.message)
                continue
            true = reference(gpu, asset, camera, side)
            if made.pixels.shape != (side, side, 4) or made.pixels.dtype != np.uint8 or not np.isfinite(true).all():
                bad += 1
                continue
            exact = made.rung == EXACT
            errors[exact].append(alpha_error(made.pixels[:, :, 3], true[:, :, 3]))
            off = np.abs(made.pixels[:, :, 3] / 255.0 - true[:, :, 3]) if exact else np.zeros(1)
            wrong, largest = wrong + int((off > WRONG).sum()), max(largest, float(off.max()))
            shading.append(shading_of(made.pixels, true))
    finally:
        gpu.release()
    values: Values = {"bad_pictures": bad, "refused_views": refused, "wrong_pixels": wrong, "largest_error": _rounded(largest)}
    seen = [shading_error([one]).psnr_db for one in shading if one.bytes]
    values |= {"psnr_db": round(shading_error(shading).psnr_db, 2), "psnr_db_worst": round(min(seen), 2) if seen else None}
    for name, found in (("mask_error", errors[True]), ("original_error", errors[False])):
        values |= {name: _rounded(np.mean(found)) if found else None, f"{name}_worst": _rounded(max(found)) if found else None}
    return values


def alpha_error(made: U1, true: Array) -> float:
    """Mean error of alpha, (h, w) u1 against (h, w) f4, over the pixels that either covers in part or that differ; 0 without any."""
    mine = made / 255.0
    difference = np.abs(mine - true)
    where = ((mine > 0.0) & (mine < 1.0)) | ((true > 0.0) & (true < 1.0)) | (difference > 0.0)
    return float(difference[where].mean()) if where.any() else 0.0


def _rounded(value: Any) -> float:
    return round(float(value), 5)
