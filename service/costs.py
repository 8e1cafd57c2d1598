"""What frames cost on a device: predicted from what is known before drawing, and put right by every frame that is drawn.

A pass takes a fixed time, and more for every silhouette edge, face, sample or pixel that it treats (TERMS_OF). The coefficients are found
when the service starts, by drawing a few known shapes (`service.render.calibration`). A mesh's own ways, such as how many layers lie over
one another, are in the factor of each of its rungs: taken from the measured ladder where that is of this device, and from then on from
what its frames took.
"""

from __future__ import annotations

import math
from collections import OrderedDict
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from schemas.conventions import F8
from schemas.ladder import RungAtSize, RungKey
from schemas.render import Antialias, Source
from service.assets import MeshAsset
from service.kernels.choose_rung import TERMS, predicted
from service.rungs import OUTLINE_ERROR_PX, Rung, passes_of

FIXED, EDGES, FACES, AREA, SIDE, IMAGE, SAMPLES, BEYOND = "fixed", "edges", "faces", "area", "side", "image", "samples", "beyond"

TERMS_OF: dict[str, tuple[str, ...]] = {
    "frame": (FIXED,),
    "background": (FIXED, IMAGE),
    "edges": (FIXED, EDGES),
    "loops": (FIXED, EDGES),
    "segments": (FIXED, EDGES),
    "hull": (FIXED, FACES),
    "deform": (FIXED, FACES),
    "first_layer": (FIXED, FACES, SAMPLES),
    "line_faces": (FIXED, FACES),
    "vector_lines": (FIXED, FACES),
    "line_strokes": (FIXED, FACES),
    "clear": (FIXED, SAMPLES),
    "stencil": (FIXED, EDGES, AREA),
    "surface": (FIXED, FACES, SAMPLES),
    "charcoal": (FIXED, FACES),
    "lines_back": (FIXED, FACES, SIDE),
    "line_edges": (FIXED, FACES),
    "edge_mesh": (FIXED, FACES, SAMPLES),
    "strokes": (FIXED, SIDE),
    "rim": (FIXED, FACES, SIDE, BEYOND),
    "outline": (FIXED, EDGES, SIDE),
    "interior": (FIXED, AREA),
    "coverage": (FIXED, EDGES, SIDE),
    "resolve": (FIXED, SAMPLES),
    "read": (FIXED, AREA),
    "composite": (FIXED, AREA),
}
"""Pass -> what its time grows with. `frame` is what lies between the passes."""

FACTOR_GAINS = (0.1, 0.1, 0.5)
"""How much of what a prediction was off by goes to the device's factor, the mesh's and the rung's."""
FIRST_FRAMES = 3
"""Frames of a rung that count more."""
MOST_OFF = math.log(3.0)
"""A frame that took longer or shorter than this factor was disturbed; it counts as being off by so much."""
USUAL_EDGES = 3.0
"""Edges of a silhouette for each root of a face, before any was seen."""
MESHES_KEPT = 256
GRID: dict[Antialias, int] = {Antialias.MSAA: 2, Antialias.SSAA: 4}
"""Samples a pixel has along each side, where it is not one."""

NOMINAL: dict[str, dict[str, float]] = {
    "frame": {FIXED: 0.08},
    "background": {FIXED: 0.007, IMAGE: 2.1e-8},
    "edges": {FIXED: 0.012, EDGES: 3.2e-4},
    "loops": {FIXED: 0.015, EDGES: 6.8e-5},
    "segments": {FIXED: 0.028, EDGES: 6.1e-5},
    "hull": {FIXED: 0.026, FACES: 5.6e-5},
    "deform": {FIXED: 0.1, FACES: 2.5e-5},
    "first_layer": {FIXED: 0.3, FACES: 1.6e-4, SAMPLES: 8e-6},
    "line_faces": {FIXED: 0.03, FACES: 7e-6},
    "vector_lines": {FIXED: 0.5, FACES: 2e-4},
    "line_strokes": {FIXED: 0.05, FACES: 7e-6},
    "clear": {FIXED: 0.069, SAMPLES: 1.9e-6},
    "stencil": {FIXED: 0.12, EDGES: 5.0e-4, AREA: 3.1e-6},
    "cpu/surface": {FIXED: 0.032, FACES: 1.1e-4, SAMPLES: 7.1e-7},
    "clipped/surface": {FIXED: 0.18, FACES: 4.6e-4, SAMPLES: 1.4e-5},
    "original/surface": {FIXED: 0.33, FACES: 1.6e-4, SAMPLES: 5.6e-6},
    "charcoal": {FIXED: 0.1, FACES: 1.5e-4},
    "lines_back": {FIXED: 0.2, FACES: 1.5e-5, SIDE: 4e-3},
    "line_edges": {FIXED: 0.1, FACES: 1.5e-5},
    "edge_mesh": {FIXED: 0.5, FACES: 9e-5, SAMPLES: 2e-6},
    "strokes": {FIXED: 0.3, SIDE: 4e-3},
    "cpu/rim": {FIXED: 0.01, FACES: 8.5e-6, SIDE: 2.2e-5, BEYOND: 2.0e-4},
    "clipped/rim": {FIXED: 0.14, FACES: 1.2e-4, SIDE: 8.4e-4, BEYOND: 8.0e-4},
    "original/rim": {FIXED: 0.44, FACES: 1.1e-5, SIDE: 1.5e-4},
    "outline": {FIXED: 0.04, EDGES: 8.7e-4, SIDE: 3.3e-4},
    "interior": {FIXED: 0.052, AREA: 2.2e-6},
    "coverage": {FIXED: 0.008, EDGES: 1.8e-4, SIDE: 2.7e-4},
    "resolve": {FIXED: 0.16, SAMPLES: 2.1e-6},
    "read": {FIXED: 0.018, AREA: 5.9e-7},
    "cpu/composite": {FIXED: 0.09, AREA: 3.6e-6},
    "clipped/composite": {FIXED: 0.0135, AREA: 9.5e-7},
    "original/composite": {FIXED: 0.0136, AREA: 7.6e-7},
}
"""Of two cores with a software renderer: what is known before a device has been calibrated."""

Coefficients = Mapping[str, Mapping[str, float]]
"""Kind and pass (`kind_of`) -> term -> milliseconds."""


def kind_of(source: Source, antialias: Antialias, name: str) -> str:
    """Where the coefficients of a pass are: the same name is other work on the CPU, on a hull and on a mesh."""
    if name in ("surface", "rim", "composite"):
        return f"{'cpu' if source is Source.CLIPPED and antialias is Antialias.COVERAGE else source.value}/{name}"
    return name


@dataclass(frozen=True)
class ViewTerms:
    """What a view adds to a cost. area_px: pixels of the rectangle that is drawn, image_px: of the image; beyond_px: by which the level
    that stands for the mesh is beyond it.
    """

    area_px: float
    image_px: float
    beyond_px: float = 0.0


class _MeshCosts:
    """Of one mesh: costs (n, TERMS) and factors of its rungs, and how many edges its silhouettes have."""

    def __init__(self, asset: MeshAsset, costs: F8, edges: float) -> None:
        self.table, self.costs, self.edges = asset.rungs, costs, edges
        self.factor = 0.0
        self.rung_factors, self.frames = np.zeros(len(costs)), np.zeros(len(costs), np.int64)
        self.drawn = np.zeros(len(costs), np.bool_)
        self.scale = np.ones(len(costs))

    def rescale(self, device_factor: float) -> None:
        np.exp(self.rung_factors + (self.factor + device_factor), out=self.scale)


class CostModel:
    """Costs on one device. Belongs to the thread that draws; others may ask it.

    device: its renderer string. coefficients: as `calibrate` finds them.
    """

    def __init__(self, device: str, coefficients: Coefficients) -> None:
        self.device = device
        self._coefficients = coefficients
        self._meshes: OrderedDict[str, _MeshCosts] = OrderedDict()
        self._factor = 0.0

    def recalibrate(self, coefficients: Coefficients) -> None:
        """Take other coefficients; what was learnt is forgotten."""
        self._coefficients = coefficients
        self._meshes.clear()
        self._factor = 0.0

    def of(self, asset: MeshAsset) -> _MeshCosts:
        """The costs of a mesh."""
        name = asset.id if asset.base is None else f"{asset.base.id} moved"
        kept = self._meshes.get(name)
        if kept is None or kept.table is not asset.rungs:
            kept = self._new(asset, kept)
            self._meshes[name] = kept
            while len(self._meshes) > MESHES_KEPT:
                self._meshes.popitem(last=False)
        return kept

    def terms(self, asset: MeshAsset, view: ViewTerms) -> F8:
        """(TERMS - 1,) f8 that costs are multiplied with."""
        return _terms(self.of(asset).edges, view)

    def frame_ms(self, asset: MeshAsset, number: int, view: ViewTerms) -> float:
        """Predicted milliseconds of a frame of the mesh on its rung of that number."""
        mesh = self.of(asset)
        return float(predicted(mesh.costs, mesh.scale, _terms(mesh.edges, view), view.beyond_px, number))

    def pass_ms(self, asset: MeshAsset, number: int, passes: Iterable[str], view: ViewTerms) -> dict[str, float]:
        """The same, pass by pass."""
        mesh = self.of(asset)
        rung = mesh.table.rungs[number]
        terms = _terms(mesh.edges, view)
        terms = np.append(terms, view.beyond_px * terms[3])
        return {name: float(self._row(asset, rung, [name]) @ terms * mesh.scale[number]) for name in passes}

    def observe(self, asset: MeshAsset, number: int, view: ViewTerms, ms: float, edges: int | None) -> None:
        """Learn from a frame: what it took, and how many silhouette edges of the mesh it met (None where it took them from elsewhere).

        The first frame of a rung teaches nothing.
        """
        mesh = self.of(asset)
        guess = float(predicted(mesh.costs, mesh.scale, _terms(mesh.edges, view), view.beyond_px, number))
        if not mesh.drawn[number]:  # uploads, compiles and unpacks: no measure of those that follow
            mesh.drawn[number] = True
            return
        if edges:
            mesh.edges += (0.1 if mesh.frames.any() else 1.0) * (edges - mesh.edges)
        if not (guess > 0.0 and ms > 0.0):
            return
        off = min(max(math.log(ms / guess), -MOST_OFF), MOST_OFF)
        of_device, of_mesh, of_rung = FACTOR_GAINS
        seen = int(mesh.frames[number])
        self._factor += of_device * off
        mesh.factor += of_mesh * off
        mesh.rung_factors[number] += max(of_rung, 1.0 / (seen + 1) if seen < FIRST_FRAMES else 0.0) * off
        mesh.frames[number] += 1
        mesh.rescale(self._factor)

    def _new(self, asset: MeshAsset, before: _MeshCosts | None) -> _MeshCosts:
        table, ladder = asset.rungs, asset.ladder
        costs = np.array([self._row(asset, rung, ("frame", *passes_of(rung.source, rung.antialias))) for rung in table.rungs])
        mesh = _MeshCosts(asset, costs, _usual_edges(asset) if before is None else before.edges)
        if ladder is not None and ladder.device == self.device:
            self._seed(mesh, asset)
        elif before is not None:
            mesh.factor = before.factor
        mesh.rescale(self._factor)
        return mesh

    def _seed(self, mesh: _MeshCosts, asset: MeshAsset) -> None:
        """Factors of the rungs that the ladder has times of."""
        assert asset.ladder is not None
        measured = {rung.label: rung for rung in asset.ladder.rungs}
        facts = {fact.size: fact for fact in asset.ladder.facts}
        for number, key in enumerate(mesh.table.keys):
            if key.label not in measured:
                continue
            off = []
            for at in measured[key.label].sizes:
                terms = _terms(facts[at.size].silhouette_edges, ViewTerms(facts[at.size].area_px, float(at.size**2)))
                guess = float(predicted(mesh.costs, mesh.scale, terms, added_px(at, key), number))
                if guess > 0.0 and at.frame.p50_ms > 0.0:
                    off.append(math.log(at.frame.p50_ms / guess))
            if off:
                mesh.rung_factors[number] = sum(off) / len(off) - self._factor
                mesh.frames[number] = 1

    def _row(self, asset: MeshAsset, rung: Rung, passes: Iterable[str]) -> F8:
        """(TERMS,) f8: milliseconds for each of the terms of `choose_rung`."""
        faces = float(len(asset.faces) if rung.hull is None else asset.hulls[rung.hull].faces)
        outline = 1.0 if rung.level is None else math.sqrt(len(asset.levels[rung.level].faces) / max(1, len(asset.faces)))
        row = np.zeros(TERMS)
        for name in passes:
            c = self._coefficients.get(kind_of(rung.source, rung.antialias, name), {})
            row[0] += c.get(FIXED, 0.0) + c.get(FACES, 0.0) * faces
            row[1] += c.get(EDGES, 0.0) * outline
            row[2] += c.get(AREA, 0.0) + c.get(SAMPLES, 0.0) * GRID.get(rung.antialias, 1) ** 2
            row[3] += c.get(SIDE, 0.0)
            row[4] += c.get(IMAGE, 0.0)
            row[5] += c.get(BEYOND, 0.0)
        return row


def _terms(edges: float, view: ViewTerms) -> F8:
    return np.array([1.0, edges, view.area_px, math.sqrt(view.area_px), view.image_px])


def added_px(at: RungAtSize, key: RungKey) -> float:
    """By how many pixels the level of a measured rung was beyond the mesh."""
    return 0.0 if key.level is None or at.bound_px is None else max(0.0, at.bound_px - OUTLINE_ERROR_PX[key.antialias])


def _usual_edges(asset: MeshAsset) -> float:
    """Edges of the mesh's silhouettes: measured, or usual."""
    if asset.ladder is not None and asset.ladder.facts:
        return asset.ladder.facts[-1].silhouette_edges
    return USUAL_EDGES * math.sqrt(len(asset.faces))
