"""What this device takes for a silhouette edge, a face, a pixel: found by drawing a few spheres when the service starts."""

from __future__ import annotations

import statistics
from collections import defaultdict
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from dataclasses import dataclass
from typing import Any

import numpy as np

from geometry.tile_layout import TileLayout
from geometry.topology import build_edges
from schemas.conventions import F4, I4, Array, Frame
from schemas.lines import LineMethod, Lines, LineStyle, Stroke
from schemas.mesh import Capability
from schemas.render import Accuracy, RenderRequest, Source
from service.assets import MeshAsset
from service.costs import AREA, BEYOND, EDGES, FACES, FIXED, IMAGE, SAMPLES, SIDE, TERMS_OF, kind_of
from service.moving import Moving
from service.render.frame import RenderedImage
from service.render.line_plan import LINE_PASSES
from service.rungs import SURFACE
from service.silhouette.extract import SilhouetteTree
from service.silhouette.levels import SilhouetteLevel

Submit = Callable[[MeshAsset, RenderRequest], Future[RenderedImage]]
SPHERES = ((3, 2), (6, 3))
"""How often the faces of an octahedron are split in four, for the mesh and for its hull."""
SIDES_PX = (96, 400)
LINES = (
    Lines(method=LineMethod.FATTENED, charcoal=True, orientation="any", ridge=LineStyle(), ridge_deg=0.1),
    Lines(method=LineMethod.STROKES, stroke=Stroke(width_by="depth")),
    Lines(),
)
"""Have all passes that lines can have between them."""
FRAMES = 2
"""Timed ones of each kind, after one that is not."""
TEXELS = 256
HULL_SIZE = 1.1
"""The hull is so much larger than the sphere that its faces lie outside."""

FOLDS = 8.0
"""Outlines of hulls are so many times as long as a sphere's, folds inside included."""


@dataclass(frozen=True)
class _Sample:
    """A pass that was timed. terms: what its time may grow with."""

    terms: dict[str, float]
    ms: float


def calibrate(submit: Submit) -> dict[str, dict[str, float]]:
    """Coefficients of the device that `submit` draws on. Raises what drawing raises, BusyError when it is too busy."""
    samples: dict[str, list[_Sample]] = defaultdict(list)
    for level, of_hull in SPHERES:
        asset = sphere(level, of_hull)
        for request in _requests():
            images = [submit(asset, request).result() for _ in range(FRAMES + 1)][1:]
            for kind, sample in _samples(asset, request, images):
                samples[kind].append(sample)
        samples["deform"] += _moved(submit, asset)
    return {kind: _fitted(kind.rpartition("/")[2], of_kind) for kind, of_kind in samples.items()}


def _moved(submit: Submit, asset: MeshAsset) -> Iterator[_Sample]:
    """The pass that gives a mesh other positions, each time anew."""
    moving, places = Moving(asset), asset.frame.to_model(asset.positions)
    request = RenderRequest(width=SIDES_PX[0], height=SIDES_PX[0])
    images = [submit(moving.at(places), request).result() for _ in range(FRAMES + 1)][1:]
    return (sample for kind, sample in _samples(asset, request, images) if kind == "deform")


def sphere(level: int, of_hull: int) -> MeshAsset:
    """A clippable sphere of 8 * 4^level faces under a hull of 8 * 4^of_hull, which is its level too.

    It is not stored; its trees are single nodes.
    """
    positions, faces = octasphere(level)
    hull_positions, hull_faces = octasphere(of_hull)
    hull_normals, hull_positions = hull_positions, hull_positions * np.float32(HULL_SIZE)
    tiles = TileLayout.fitting(len(hull_faces), TEXELS)
    mesh, tree = _searched(positions, faces)
    hull, hull_tree = _searched(hull_positions, hull_faces)
    return MeshAsset(
        id=f"sphere of {len(faces)} faces",
        frame=Frame((0.0, 0.0, 0.0), 1.0),
        positions=positions,
        faces=faces,
        normals=positions,
        appearance=None,
        edges=(mesh["edge_vertices"], mesh["edge_faces"]),
        hull={"positions": hull_positions, "faces": hull_faces, "normals": hull_normals},
        maps={
            "tile_uv": tiles.tile_uv(np.zeros(len(hull_faces), np.int32)),
            "normal": np.full((tiles.height, tiles.width, 3), 200, np.uint8),
        },
        tree=SilhouetteTree(mesh, tree),
        clip=Capability(available=True),
        levels=(SilhouetteLevel(hull | {"bound": np.array([HULL_SIZE - 1.0])}, hull_tree),),
    )


def _searched(positions: F4, faces: I4) -> tuple[dict[str, Any], dict[str, Array]]:
    """(tensors of a closed mesh, of its tree) of a surface, as `SilhouetteTree` takes them."""
    edges = build_edges(faces)
    mesh: dict[str, Any] = {"positions": positions, "faces": faces, "edge_vertices": edges.vertices, "edge_faces": edges.faces}
    count = len(edges.vertices)
    tree: dict[str, Array] = {name: np.zeros((1, 3), np.float32) for name in ("scaled_normal", "front_anchor", "back_anchor")}
    tree |= {"separation": np.zeros(1, np.float32), "skip": np.array([1], np.int32), "edge_index": np.arange(count, dtype=np.int32)}
    return mesh, tree | {"edge_start": np.array([0, count], np.int32)}


def octasphere(level: int) -> tuple[F4, I4]:
    """(positions (v, 3) f4, faces (f, 3) i4) of an octahedron whose faces are split in four so often, on the unit sphere."""
    points = np.concatenate([np.eye(3), -np.eye(3)])
    faces = np.array([[0, 1, 2], [1, 3, 2], [3, 4, 2], [4, 0, 2], [1, 0, 5], [3, 1, 5], [4, 3, 5], [0, 4, 5]], np.int32)
    for _ in range(level):
        ends = np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
        edges, number = np.unique(ends, axis=0, return_inverse=True)
        middle = len(points) + number.reshape(-1, 3)
        points = np.concatenate([points, points[edges].mean(axis=1)])
        a, b, c = faces.T
        ab, bc, ca = middle.T
        faces = np.concatenate([np.stack(part, axis=1) for part in ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))]).astype(np.int32)
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    return points.astype(np.float32), np.ascontiguousarray(faces)


def _requests() -> Iterator[RenderRequest]:
    for side in SIDES_PX:
        for source, antialias in SURFACE:
            for level in (-1, 0) if source is Source.CLIPPED else (None,):
                yield RenderRequest(width=side, height=side, accuracy=Accuracy(source=source, antialias=antialias, level=level))
        yield from (RenderRequest(width=side, height=side, lines=lines) for lines in LINES)


def _samples(asset: MeshAsset, request: RenderRequest, images: list[RenderedImage]) -> Iterator[tuple[str, _Sample]]:
    """Every pass of these pictures, and what lies between the passes, by kind; of pictures with lines, the passes of lines alone."""
    first = images[0]
    assert first.planned is not None
    plan, area = first.planned, first.area.pixels
    faces = len(asset.faces) if plan.hull is None else asset.hulls[plan.hull].faces
    terms = {
        FIXED: 1.0, EDGES: float(first.edges), FACES: float(faces), AREA: float(area), SIDE: area**0.5,
        IMAGE: float(request.width * request.height), SAMPLES: float(area * plan.sample_grid**2),
        BEYOND: 0.0 if plan.level is None else plan.level.error_px * area**0.5,
    }  # fmt: skip
    for name in first.plan if request.lines is None else (step for step in first.plan if step in LINE_PASSES):
        ms = statistics.median(dict(image.passes)[name] for image in images)
        yield kind_of(plan.source, plan.antialias, name), _Sample(terms, ms)
    if request.lines is not None:
        return
    between = statistics.median(image.ms - sum(ms for _, ms in image.passes) for image in images)
    yield "frame", _Sample(terms, between)


def _fitted(name: str, samples: list[_Sample]) -> dict[str, float]:
    """Coefficients, none below zero, that are off by the least part of each time."""
    from scipy.optimize import nnls  # a third of a second that starting the service need not wait for

    names = [term for term in TERMS_OF[name] if any(sample.terms[term] for sample in samples)]
    times = np.array([max(sample.ms, 1e-4) for sample in samples])
    matrix = np.array([[sample.terms[term] for term in names] for sample in samples]) / times[:, None]
    size = np.abs(matrix).max(axis=0)
    found, _ = nnls(matrix / size, np.ones(len(samples)))
    coefficients = {term: float(value) for term, value in zip(names, found / size, strict=True) if value > 0.0}
    if BEYOND in coefficients:
        coefficients[BEYOND] *= FOLDS
    return coefficients
