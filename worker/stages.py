"""The stages, each as: inputs from the store, one pure function, what to keep.

load    reports frame, stats, capabilities, repairs; keeps mesh, appearance
hull    reports faces, volume_excess; keeps hull, hull_sequence
bake    reports missed, texel_count, tile_side; keeps maps, hull.glb, normal.png, color.png
levels  reports levels, capabilities; keeps level_0, level_0_tree, ...
tree    reports nodes; keeps tree
inner   reports levels, capabilities; keeps inner_sequence
verify  reports what was checked, capabilities that are withheld; keeps nothing
hulls   reports hulls, left_out: what was not made, and why; keeps hull_1, maps_1 (coarser), hull_2, maps_2 (finer)
measure reports the measured ladder (`schemas.ladder.Ladder`); keeps nothing

A mesh that cannot be clipped has use for load, verify and measure only.
"""

from __future__ import annotations

import hashlib
import importlib
import logging
import sys
from collections.abc import Callable
from dataclasses import dataclass, field, fields
from functools import cached_property, partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from backend import records
from backend.artifacts import read_artifact
from backend.store import Store
from schemas import artifacts, jobs, keys
from schemas.artifacts import Layout
from schemas.conventions import F4, I4, Frame
from schemas.errors import CorruptArtifactError, DamagedArtifactError
from schemas.manifest import Accepted
from worker import downloads
from worker.bake import Maps, bake_hull, hull_normals
from worker.distance import ROUGHLY
from worker.enclosure import Solid
from worker.hull import Hull, build_hull
from worker.hulls import HullSource, described, other_hulls
from worker.levels import HullLevel, build_levels, hull_levels, level_sizes
from worker.load import LoadedMesh, load_mesh
from worker.side_by_side import run_side_by_side
from worker.tree import Tree, build_tree
from worker.verify import check_edges, check_surface, verify_artifacts
from worker.verify_levels import verify_inner, verify_level

log = logging.getLogger("silhouette.stages")

Tensors = dict[str, npt.NDArray[Any]]


@dataclass(frozen=True)
class Result:
    """What a stage made: artifacts and downloads to publish, and its report (plain JSON)."""

    report: dict[str, Any] = field(default_factory=dict)
    artifacts: list[tuple[Layout, Tensors]] = field(default_factory=list)
    downloads: dict[str, bytes] = field(default_factory=dict)
    skipped: bool = False


SKIPPED = Result(skipped=True)
CLIPPING_PARTS = frozenset({"hull", "maps", "tree"})
"""Names by which `verify_artifacts` blames what only clipping needs."""


class HullSurface(NamedTuple):
    """positions (hv, 3) f4 and faces (hf, 3) i4 of a stored hull."""

    positions: F4
    faces: I4


class Inputs:
    """What a stage may read of its mesh. `progress` takes a fraction and raises CancelledError when the mesh is gone.

    `pause`: whether others wait for the worker, for a stage that can be interrupted.
    """

    def __init__(self, store: Store, mesh_id: str, progress: Callable[[float], None], pause: Callable[[], bool]) -> None:
        self.store = store
        self.mesh_id = mesh_id
        self.progress = progress
        self.pause = pause

    @cached_property
    def accepted(self) -> Accepted:
        """The acceptance record, with the options. Raises DamagedUploadError."""
        return records.read_accepted(self.store, self.mesh_id)

    @cached_property
    def loaded(self) -> dict[str, Any]:
        """The report of the stage load."""
        return self.report("load")

    def report(self, stage: str) -> dict[str, Any]:
        """The report of an earlier stage. Raises CorruptArtifactError when there is none."""
        record = records.read_stage(self.store, self.mesh_id, stage)
        if record is None:
            raise CorruptArtifactError("the record of an earlier stage is missing", stage=stage)
        return record.report

    @property
    def clippable(self) -> bool:
        """Whether the mesh is a closed oriented surface."""
        return bool(self.loaded["capabilities"]["clip"]["available"])

    @property
    def is_clipped(self) -> bool:
        """Whether the mesh, which is ready, is drawn as a clipped hull: what that needs has passed its checks."""
        manifest = records.read_manifest(self.store, self.mesh_id)
        return manifest is not None and "clip" in manifest.capabilities and manifest.capabilities["clip"].available

    @property
    def frame(self) -> Frame:
        """The normalised frame."""
        return Frame(tuple(self.loaded["frame"]["centre"]), self.loaded["frame"]["scale"])

    def upload(self) -> Path:
        """The uploaded file, compared with the hash it was accepted with. Raises DamagedUploadError."""
        return records.upload_path(self.store, self.accepted.upload_sha256)

    def tensors(self, layout: Layout) -> Tensors:
        """An artifact in memory: copies, since kernels compiled for writable arrays would be compiled again for views.

        Raises NotFoundError, DamagedArtifactError.
        """
        return {name: np.array(view) for name, view in read_artifact(self.store, self.mesh_id, layout).items()}

    def tensors_if_any(self, layout: Layout) -> Tensors | None:
        """The same, or None where the mesh has no such artifact."""
        return self.tensors(layout) if self.has(layout) else None

    def has(self, layout: Layout) -> bool:
        """Whether the mesh has such an artifact."""
        return self.store.exists(keys.artifact(self.mesh_id, layout.file))


def load(inputs: Inputs) -> Result:
    """The upload, cleaned and indexed."""
    accepted = inputs.accepted
    return loaded(load_mesh(inputs.upload(), accepted.extension, accepted.options, progress=inputs.progress))


def loaded(mesh: LoadedMesh) -> Result:
    """What to keep of a mesh that has been read."""
    tensors: Tensors = {"positions": mesh.positions, "faces": mesh.faces, **mesh.shading.tensors()}
    if mesh.edges is not None:
        tensors |= {"edge_vertices": mesh.edges.vertices, "edge_faces": mesh.edges.faces}
    kept: list[tuple[Layout, Tensors]] = [(artifacts.MESH, tensors), (artifacts.FILE_VERTICES, {"file_vertices": mesh.file_vertices})]
    if mesh.appearance is not None:
        kept.append((artifacts.APPEARANCE, mesh.appearance))
    report = {
        "frame": {"centre": list(mesh.frame.centre), "scale": mesh.frame.scale},
        "stats": mesh.stats.model_dump(mode="json"),
        "capabilities": {"clip": mesh.clip.model_dump(mode="json")},
        "repairs": mesh.repairs,
    }
    return Result(report, kept)


def hull(inputs: Inputs) -> Result:
    """The coarse hull that is drawn."""
    if not inputs.clippable:
        return SKIPPED
    mesh = inputs.tensors(artifacts.MESH)
    made = build_hull(mesh["positions"], mesh["faces"], inputs.accepted.options.hull_faces, inputs.progress)
    hull_tensors: Tensors = {"positions": made.positions, "faces": made.faces, "normals": hull_normals(made.positions, made.faces)}
    report = {"faces": len(made.faces), "volume_excess": min(made.volume_excess, sys.float_info.max)}
    return Result(report, [(artifacts.HULL, hull_tensors), (artifacts.HULL_SEQUENCE, sequence_of(made))])


def sequence_of(made: Hull) -> Tensors:
    """The tensors of `artifacts.HULL_SEQUENCE`."""
    return {name: getattr(made, name) for name in artifacts.HULL_SEQUENCE.tensors}


def bake(inputs: Inputs) -> Result:
    """Normal and colour maps over the hull, and the files made of them."""
    if not inputs.clippable:
        return SKIPPED
    mesh, coarse = inputs.tensors(artifacts.MESH), inputs.tensors(artifacts.HULL)
    maps = bake_hull(mesh, coarse, inputs.tensors_if_any(artifacts.APPEARANCE), inputs.accepted.options.texels, inputs.progress)
    report = {"missed": int(maps.missed), "texel_count": int(maps.texel_count), "tile_side": int(maps.tile_side)}
    return Result(report, [(artifacts.MAPS, maps.tensors())], files_of(coarse, maps, inputs.frame))


def files_of(coarse: Tensors, maps: Maps, frame: Frame) -> dict[str, bytes]:
    """The downloads by name; no colour map where the mesh has no colour."""
    made = HullSurface(coarse["positions"], coarse["faces"])
    files = {artifacts.HULL_GLB: downloads.hull_glb(made, maps, frame), artifacts.NORMAL_PNG: downloads.normal_png(maps)}
    if maps.color is not None:
        files[artifacts.COLOR_PNG] = downloads.color_png(maps)
    return files


def levels(inputs: Inputs) -> Result:
    """Hulls that stand for the original in far views, with their trees."""
    if not inputs.clippable:
        return SKIPPED
    mesh, sequence = inputs.tensors(artifacts.MESH), inputs.tensors(artifacts.HULL_SEQUENCE)
    steps = (sequence["step_vertices"], sequence["step_positions"])
    made = build_levels(mesh["positions"], mesh["faces"], steps, inputs.report("hull")["faces"], inputs.progress)
    kept: list[tuple[Layout, Tensors]] = []
    for place, tree_place, level in zip(artifacts.LEVELS, artifacts.LEVEL_TREES, made, strict=False):
        kept += [(place, level.tensors()), (tree_place, level.tree.tensors())]
    return Result(levels_report("levels", "outer", [level.hull for level in made], inputs.frame), kept)


def levels_report(capability: str, side: str, made: list[HullLevel], frame: Frame) -> dict[str, Any]:
    """The measured hulls as `schemas.mesh.HullLevel`, distances in model units, and whether there are any."""
    listed = [
        {"side": side, "faces": len(one.faces), "volume_excess": one.volume_excess, "distance": one.bound * frame.scale} for one in made
    ]
    reason = None if made else "the mesh is too small for hulls of other sizes to be worth it"
    return {"levels": listed, "capabilities": {capability: {"available": bool(made), "reason": reason}}}


def inner(inputs: Inputs) -> Result:
    """The sequence of hulls that the original encloses."""
    if not inputs.clippable:
        return SKIPPED
    mesh = inputs.tensors(artifacts.MESH)
    surface = (mesh["positions"], mesh["faces"])
    made = build_hull(*surface, inputs.accepted.options.hull_faces, lambda part: inputs.progress(0.9 * part), side="inner")
    sizes = level_sizes(len(mesh["faces"]), len(made.faces)) or [len(made.faces)]
    steps = (made.step_vertices, made.step_positions)
    measured = hull_levels(*surface, steps, sizes, lambda part: inputs.progress(0.9 + 0.1 * part), ROUGHLY)
    return Result(levels_report("inner", "inner", measured, inputs.frame), [(artifacts.INNER_SEQUENCE, sequence_of(made))])


def tree(inputs: Inputs) -> Result:
    """The silhouette search tree."""
    if not inputs.clippable:
        return SKIPPED
    mesh = inputs.tensors(artifacts.MESH)
    made = build_tree(mesh["positions"], mesh["faces"], mesh["edge_vertices"], mesh["edge_faces"], inputs.progress)
    tensors: Tensors = {part.name: getattr(made, part.name) for part in fields(Tree)}
    return Result({"nodes": len(made.skip)}, [(artifacts.TREE, tensors)])


def verify(inputs: Inputs) -> Result:
    """Check the artifacts as stored, by themselves and against each other, in two threads.

    A fault in what clipping needs takes that capability from the mesh, which is then drawn from the original; a fault in a level
    or an inner hull takes those. Raises CorruptArtifactError when the mesh itself is at fault.
    """
    mesh = inputs.tensors(artifacts.MESH)
    if not inputs.clippable:
        return Result({"capabilities": {}, **verify_artifacts(mesh, None, None, None, inputs.progress)})
    # what all checks stand on: kernels take indices as they are
    check_surface(mesh, "mesh")
    check_edges(mesh)
    original = Solid(mesh["positions"], mesh["faces"])
    tasks = [*level_checks(inputs, original), lambda: clipping_checked(inputs, mesh), lambda: inner_checked(inputs, original)]
    *of_levels, of_clipping, of_inner = run_side_by_side(tasks, inputs.progress)
    capabilities: dict[str, Any] = {}
    report: dict[str, Any] = {"capabilities": capabilities}
    try:
        report |= of_clipping.result()
    except CorruptArtifactError as error:
        if isinstance(error, DamagedArtifactError) or error.where.get("artifact") not in CLIPPING_PARTS:
            raise
        capabilities["clip"] = withheld("clipping", error)
    try:
        report["levels"] = [of_level.result() for of_level in of_levels]
    except DamagedArtifactError:
        raise
    except CorruptArtifactError as error:
        capabilities["levels"] = withheld("levels", error)
    try:
        report["inner"] = of_inner.result() or None
    except DamagedArtifactError:
        raise
    except CorruptArtifactError as error:
        capabilities["inner"] = withheld("inner hulls", error)
    return Result(report)


def clipping_checked(inputs: Inputs, mesh: Tensors) -> dict[str, Any]:
    """What was checked of the mesh and of what clipping needs. Raises CorruptArtifactError."""
    coarse, maps, search = (inputs.tensors_if_any(layout) for layout in (artifacts.HULL, artifacts.MAPS, artifacts.TREE))
    return verify_artifacts(mesh, coarse, maps, search, lambda part: None)


def level_checks(inputs: Inputs, original: Solid) -> list[Callable[[], dict[str, Any]]]:
    """A check for each level that the mesh has: what was checked of it. They raise CorruptArtifactError."""

    def check(place: Layout, tree_place: Layout) -> dict[str, Any]:
        return verify_level(original, inputs.tensors(place), inputs.tensors(tree_place))

    places = zip(artifacts.LEVELS, artifacts.LEVEL_TREES, strict=True)
    return [partial(check, *pair) for pair in places if all(inputs.has(layout) for layout in pair)]


def inner_checked(inputs: Inputs, original: Solid) -> dict[str, Any]:
    """What was checked of the inner hulls, nothing where the mesh has none. Raises CorruptArtifactError."""
    sequence = inputs.tensors_if_any(artifacts.INNER_SEQUENCE)
    return verify_inner(original, sequence) if sequence else {}


def withheld(what: str, error: CorruptArtifactError) -> dict[str, Any]:
    """The capability that a mesh lost to a fault in what it needs."""
    log.exception("%s withheld: %s", what, error.message, extra=error.where)
    return {"available": False, "reason": f"its preprocessing did not pass the checks: {error.message}"}


def hulls(inputs: Inputs) -> Result:
    """Hulls of other sizes that can be drawn, with their maps."""
    if not inputs.is_clipped:
        return SKIPPED
    mesh, drawn, sequence = (inputs.tensors(layout) for layout in (artifacts.MESH, artifacts.HULL, artifacts.HULL_SEQUENCE))
    source = HullSource(mesh, drawn, sequence, inputs.tensors_if_any(artifacts.APPEARANCE), inputs.accepted.options.texels)
    made, left_out = other_hulls(source, inputs.progress)
    kept: list[tuple[Layout, Tensors]] = []
    for place, maps_place, one in zip(artifacts.OTHER_HULLS, artifacts.OTHER_MAPS, made, strict=True):
        kept += [] if one is None else [(place, one.hull), (maps_place, one.maps)]
    return Result({"hulls": [described(one) for one in made if one is not None], "left_out": left_out}, kept)


def measure(inputs: Inputs) -> Result | None:
    """The measured ladder, by the one callable here that draws; None when it paused. Imported by name: this side has no renderer."""
    module, _, name = jobs.MEASURE.rpartition(".")
    report = getattr(importlib.import_module(module), name)(inputs.store, inputs.mesh_id, inputs.progress, inputs.pause)
    return None if report is None else Result(report)


def sha256(data: bytes) -> str:
    """Hash of a download, hex."""
    return hashlib.sha256(data).hexdigest()
