"""What rendering and extraction need of a mesh, mapped from its artifacts."""

from __future__ import annotations

import logging
import math
import threading
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from pydantic import ValidationError

from backend.artifacts import read_artifact
from backend.store import Store
from geometry.tile_layout import TileLayout
from geometry.topology import EdgeTable, build_edges, signed_volume
from schemas import artifacts
from schemas.conventions import F4, F8, I4, Array, Frame
from schemas.errors import NotReadyError
from schemas.jobs import LATER_STAGES
from schemas.ladder import Ladder
from schemas.manifest import Manifest
from schemas.mesh import Capability
from service.line_surface import LineSurface
from service.rungs import LEAST_SIDE, MOST_HALVINGS, HullFacts, RungTable, rung_table
from service.silhouette.extract import SilhouetteTree
from service.silhouette.levels import SilhouetteLevel
from service.silhouette.line_mesh import LineMesh
from service.silhouette.smooth import SmoothSurface

log = logging.getLogger("silhouette.service")

CLIP, LEVELS = "clip", "levels"
"""Names of capabilities in the manifest."""
LARGER = 0.9
"""Part of a hull's area that is in faces no larger than its typical larger one, whose texels are counted."""

READY = "ready"
"""Status of a manifest whose mesh has all that `STAGES` make."""

Tensors = Callable[[artifacts.Layout], dict[str, Any] | None]
"""Opens an artifact; None for one that the mesh does not have."""


@dataclass(frozen=True)
class DrawnHull:
    """A hull that can be drawn: tensors of HULL and of MAPS by name; without maps its own normals are drawn."""

    hull: dict[str, Any]
    maps: dict[str, Any]

    @property
    def faces(self) -> int:
        """How many it has."""
        return len(self.hull["faces"])

    @cached_property
    def edges(self) -> EdgeTable:
        """Its edges."""
        return build_edges(np.asarray(self.hull["faces"]))

    @cached_property
    def facts(self) -> HullFacts:
        """What rungs depend on of it."""
        if not self.maps:
            return HullFacts(self.faces, (0,), 0.0)
        height, width = self.maps["normal"].shape[:2]
        layout = TileLayout.of(self.maps["tile_uv"], width, height)
        halved = [layout.halved(times) for times in range(MOST_HALVINGS + 1)]
        texels = tuple(max(one.width, one.height) for times, one in enumerate(halved) if not times or one.side >= LEAST_SIDE)
        corners = self.hull["positions"].astype(np.float64)[self.hull["faces"]]
        areas = 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
        order = np.argsort(areas)
        smaller = np.cumsum(areas[order]) <= LARGER * areas.sum()
        typical = float(areas[order[min(int(smaller.sum()), len(order) - 1)]])
        return HullFacts(self.faces, texels, layout.side / math.sqrt(2.0 * typical) if typical > 0.0 else 0.0)

    @cached_property
    def convex_planes(self) -> F8:
        """(k, 4) f8 unit outward planes of its convex hull: n . p + d is at most 0 inside. No planes for a flat one."""
        from scipy.spatial import ConvexHull, QhullError  # a third of a second that starting the service need not wait for

        try:
            return ConvexHull(self.hull["positions"].astype(np.float64)).equations
        except QhullError:
            return np.empty((0, 4))

    @property
    def nbytes(self) -> int:
        """Bytes of all arrays."""
        return sum(int(a.nbytes) for part in (self.hull, self.maps) for a in part.values())


@dataclass(frozen=True)
class MeshAsset:
    """A mesh that can be drawn, in its normalised frame. The dictionaries hold the tensors of `schemas.artifacts` by name.

    positions (v, 3) f4, faces (f, 3) i4, normals (n, 3) f4. appearance: APPEARANCE, or None when the mesh has no colour.
    edges: (edge_vertices, edge_faces) of a closed oriented mesh. hull: HULL, maps: MAPS, tree: its silhouette tree; all None
    when the mesh is not clippable, or not yet. clip: whether it is, and why not.
    normal_vertices (n,) i4, corner_normals (f, 3) i4: as in MESH; None when vertex i has the one normal i.
    levels: hulls that may stand for it in far views, finest first. other_hulls: that can be drawn, of other sizes than was asked for.
    ladder: what was measured of it, if anything. base: the mesh that this one is, its vertices moved (`service.moving`), if it is one;
    faces, edges and the numbers of normals are those of the base.
    """

    id: str
    frame: Frame
    positions: F4
    faces: I4
    normals: F4
    appearance: dict[str, Array] | None
    edges: tuple[I4, I4] | None
    hull: dict[str, Any] | None
    maps: dict[str, Any] | None
    tree: SilhouetteTree | None
    clip: Capability
    normal_vertices: I4 | None = None
    corner_normals: I4 | None = None
    levels: tuple[SilhouetteLevel, ...] = ()
    other_hulls: tuple[DrawnHull, ...] = ()
    ladder: Ladder | None = None
    base: MeshAsset | None = None

    @cached_property
    def hulls(self) -> tuple[DrawnHull, ...]:
        """All hulls that can be drawn, the one that was asked for first."""
        return () if self.hull is None else (DrawnHull(self.hull, self.maps or {}), *self.other_hulls)

    @cached_property
    def rungs(self) -> RungTable:
        """Every way in which it can be drawn."""
        if self.base is not None:
            return self.base.moved_rungs
        levels = [(len(level.faces), level.bound) for level in self.levels]
        return rung_table(self.clippable, levels, [hull.facts for hull in self.hulls], self.ladder)

    @cached_property
    def moved_rungs(self) -> RungTable:
        """Every way in which it can be drawn once its vertices are moved, which leaves its hulls behind."""
        return rung_table(False, (), (), None)

    @cached_property
    def encloses(self) -> bool:
        """Whether faces are seen from outside where the mesh is closed: loading sees to that, but moving may turn a mesh inside out."""
        return self.edges is not None and (self.base is None or signed_volume(self.positions, self.faces) > 0.0)

    @property
    def normal_positions(self) -> F4:
        """(n, 3) f4: where each normal is."""
        return self.positions if self.normal_vertices is None else self.positions[self.normal_vertices]

    @property
    def shading_faces(self) -> I4:
        """(f, 3) i4: rows of `normals` and `normal_positions` at the corners of the faces."""
        return self.faces if self.corner_normals is None else self.corner_normals

    @property
    def clippable(self) -> bool:
        """Whether its silhouette can be extracted and a hull be clipped to it."""
        return self.clip.available and self.hull is not None and self.tree is not None

    @cached_property
    def smooth_surface(self) -> SmoothSurface:
        """The closed mesh as a surface with interpolated normals."""
        assert self.edges is not None
        count = len(self.normals)
        vertices = np.arange(count, dtype=np.int32) if self.normal_vertices is None else self.normal_vertices
        return SmoothSurface((self.positions, self.faces), (self.normals, vertices, self.shading_faces), self.edges)

    @cached_property
    def line_surface(self) -> LineSurface:
        """The mesh as lines are found on it; it need not be closed."""
        return LineSurface(self.positions, self.faces, self.edges, None if self.base is None else self.base.line_surface)

    @cached_property
    def stretched(self) -> dict[bytes, MeshAsset]:
        """The mesh in other shapes, by the matrix that made them, the latest last (`service.scene.stretch`)."""
        return {}

    @cached_property
    def line_mesh(self) -> LineMesh:
        """The mesh made ready for finding lines, whether it is closed or not."""
        return LineMesh(self.positions, self.faces, None if self.base is None else self.base.line_mesh)

    @cached_property
    def _edge_order(self) -> tuple[Array, Array]:
        """Keys of the edges in ascending order, and the edges in that order."""
        assert self.edges is not None
        low, high = self.edges[0].min(axis=1).astype(np.int64), self.edges[0].max(axis=1)
        key = low * len(self.positions) + high
        order = np.argsort(key)
        return key[order], order

    def left_faces(self, edges: I4) -> I4:
        """(s,) i4: the face to the left of each directed edge (s, 2) of a closed mesh."""
        assert self.edges is not None
        keys_in_order, order = self._edge_order
        key = edges.min(axis=1).astype(np.int64) * len(self.positions) + edges.max(axis=1)
        found = order[np.searchsorted(keys_in_order, key)]
        same = self.edges[0][found, 0] == edges[:, 0]
        return np.where(same, self.edges[1][found, 0], self.edges[1][found, 1])

    @cached_property
    def corners(self) -> F8:
        """(8, 3) f8: the corners of the mesh's bounding box."""
        low, high = self.positions.min(axis=0), self.positions.max(axis=0)
        choice = np.array([[i & 1, i >> 1 & 1, i >> 2] for i in range(8)], bool)
        return np.where(choice, high, low).astype(np.float64)

    @cached_property
    def extreme_points(self) -> F8:
        """(k, 3) f8: vertices of the mesh's convex hull; the corners of its bounding box when it is flat."""
        from scipy.spatial import ConvexHull, QhullError

        points = self.positions.astype(np.float64)
        try:
            return points[ConvexHull(points).vertices]
        except QhullError:
            return self.corners

    @cached_property
    def radius(self) -> float:
        """Radius of a sphere about the origin that holds the mesh and its hulls; at least 1, and that of what was moved."""
        if self.base is not None:
            return max(self.base.radius, float(np.linalg.norm(self.positions.astype(np.float64), axis=1).max()))
        hulls = [part for part in (self.hull, *(one.hull for one in self.other_hulls)) if part is not None]
        return max([1.0, *(float(np.linalg.norm(hull["positions"].astype(np.float64), axis=1).max()) for hull in hulls)])

    @property
    def nbytes(self) -> int:
        """Bytes of all arrays."""
        groups = (self.appearance or {}, self.hull or {}, self.maps or {})
        given = (self.normal_vertices, self.corner_normals, *(self.edges or ()))
        arrays = [self.positions, self.faces, self.normals, *(a for group in groups for a in group.values())]
        arrays += [a for a in given if a is not None]
        lines = self.__dict__["line_mesh"].nbytes if "line_mesh" in self.__dict__ else 0
        parts = sum(level.nbytes for level in self.levels) + sum(hull.nbytes for hull in self.other_hulls)
        shapes = sum(int(one.positions.nbytes + one.normals.nbytes) for one in list(self.stretched.values()))
        return sum(int(a.nbytes) for a in arrays) + parts + lines + shapes


def state_of(manifest: Manifest) -> str:
    """What an asset is made from: how far its mesh is, and which later stages are done. Pictures may differ between states."""
    later = [record.stage for record in manifest.stages if record.stage in LATER_STAGES and record.outcome == "done"]
    return "+".join([manifest.status, *later])


def load_asset(store: Store, manifest: Manifest) -> MeshAsset:
    """Map the artifacts that there are of a ready or loaded mesh. Raises NotReadyError when it is neither, DamagedArtifactError."""
    if manifest.status == "failed" or manifest.frame is None:
        raise NotReadyError("the mesh is not ready")
    tensors = _mapper(store, manifest)
    mesh = tensors(artifacts.MESH)
    if mesh is None:
        raise NotReadyError("the mesh has no geometry yet")
    edges = (mesh["edge_vertices"], mesh["edge_faces"]) if "edge_vertices" in mesh else None
    tree = tensors(artifacts.TREE)
    return MeshAsset(
        id=manifest.id,
        frame=Frame(manifest.frame.centre, manifest.frame.scale),
        positions=mesh["positions"],
        faces=mesh["faces"],
        normals=mesh["normals"],
        appearance=tensors(artifacts.APPEARANCE),
        edges=edges,
        hull=tensors(artifacts.HULL),
        maps=tensors(artifacts.MAPS),
        tree=None if tree is None or edges is None else SilhouetteTree(mesh, tree),
        clip=manifest.capabilities.get(CLIP, Capability(available=False, reason="the mesh was not prepared for clipping")),
        normal_vertices=mesh.get("normal_vertices"),
        corner_normals=mesh.get("corner_normals"),
        levels=_levels(manifest, tensors),
        other_hulls=_other_hulls(tensors),
        ladder=_ladder(manifest),
    )


def _mapper(store: Store, manifest: Manifest) -> Tensors:
    """Opens artifacts of a mesh; None for one that it does not have."""
    present = {name for stage in manifest.stages for name in stage.artifacts}

    def tensors(layout: artifacts.Layout) -> dict[str, Any] | None:
        return read_artifact(store, manifest.id, layout) if layout.file in present else None

    return tensors


def _other_hulls(tensors: Tensors) -> tuple[DrawnHull, ...]:
    """Those that the stage hulls made, the coarser first."""
    found = ((tensors(place), tensors(maps)) for place, maps in zip(artifacts.OTHER_HULLS, artifacts.OTHER_MAPS, strict=True))
    return tuple(DrawnHull(hull, maps) for hull, maps in found if hull is not None and maps is not None)


def _ladder(manifest: Manifest) -> Ladder | None:
    """What the stage measure found; None when it has not, or when another version did, whose report cannot be read."""
    record = next((record for record in manifest.stages if record.stage == "measure" and record.outcome == "done"), None)
    try:
        return None if record is None else Ladder.model_validate(record.report)
    except ValidationError:
        log.warning("a measured ladder cannot be read", extra={"mesh": manifest.id}, exc_info=True)
        return None


def _levels(manifest: Manifest, tensors: Tensors) -> tuple[SilhouetteLevel, ...]:
    """Those that passed their checks."""
    if LEVELS not in manifest.capabilities or not manifest.capabilities[LEVELS].available:
        return ()
    found = ((tensors(place), tensors(tree)) for place, tree in zip(artifacts.LEVELS, artifacts.LEVEL_TREES, strict=True))
    return tuple(SilhouetteLevel(mesh, tree) for mesh, tree in found if mesh is not None and tree is not None)


class AssetCache:
    """Assets in use, least recently used first to go when they are more than `capacity_mib` together. Thread-safe.

    Of a mesh there is one, that of the latest state it was asked for in.
    """

    def __init__(self, store: Store, capacity_mib: int) -> None:
        self._store, self._capacity = store, capacity_mib << 20
        self._kept: OrderedDict[str, tuple[str, MeshAsset]] = OrderedDict()
        self._lock = threading.Lock()

    def get(self, manifest: Manifest) -> MeshAsset:
        """The asset of a ready or loaded mesh. Raises NotReadyError, DamagedArtifactError."""
        if (held := self.held(manifest)) is not None:
            return held
        state = state_of(manifest)
        with self._lock:
            earlier, kept = self._kept.get(manifest.id, (None, None))
        if kept is not None and earlier is not None and earlier.startswith(READY) and manifest.status == READY:
            tensors = _mapper(self._store, manifest)  # the rest is the same: its trees are packed and its files mapped
            asset = replace(kept, other_hulls=_other_hulls(tensors), ladder=_ladder(manifest))
        else:
            asset = load_asset(self._store, manifest)
        with self._lock:
            self._kept[asset.id] = state, asset
            self._kept.move_to_end(asset.id)
            while len(self._kept) > 1 and sum(a.nbytes for _, a in self._kept.values()) > self._capacity:
                self._kept.popitem(last=False)
        return asset

    def held(self, manifest: Manifest) -> MeshAsset | None:
        """The asset of a mesh if it is in use already: does not block."""
        state = state_of(manifest)
        with self._lock:
            earlier, kept = self._kept.get(manifest.id, (None, None))
            if kept is None or earlier != state:
                return None
            self._kept.move_to_end(manifest.id)
            return kept

    @property
    def nbytes(self) -> int:
        """Bytes of all arrays of the assets in use."""
        with self._lock:
            return sum(asset.nbytes for _, asset in self._kept.values())

    def drop(self, mesh_id: str) -> None:
        """Forget a mesh that was deleted."""
        with self._lock:
            self._kept.pop(mesh_id, None)
