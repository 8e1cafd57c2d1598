"""The last look at what a mesh's preprocessing made, before it is published.

Everything here reads the arrays as they were stored, float32 values included, and shares no code with what made them except
the mesh topology and the exact predicates. What a hull must be: Silhouette Clipping, section 3 (closed, oriented, its
positive winding volume contains the original's); a tree: section 5.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt

from geometry.predicates import front_facing
from geometry.tile_layout import TileLayout
from geometry.topology import NotManifoldError, build_edges, face_normals, signed_volume
from schemas.conventions import F8
from schemas.errors import CorruptArtifactError
from worker.enclosure import NotEnclosedError, UnprovenError, enclosure_fault
from worker.kernels import verify_enclosure, verify_maps, verify_tree

Values = npt.NDArray[Any]
Tensors = dict[str, Values]
Check = tuple[str, Callable[[], dict[str, Any] | None]]

FRAME_SLACK = 1e-5  # by which the original may leave the unit sphere: float32 rounding and no more
UNIT_SLACK = 1e-4  # of stored float32 unit vectors
TEXEL_SLACK = 0.012  # of a unit vector rounded to 1/127.5 a component: sqrt(3) / 2 / 127.5, and its share of a rounding scale
VOLUME_SLACK = 1e-6  # of the original's volume: what float64 sums lose
MOST_AWAY = 0.7  # of the texels may face away from their hull face; with flipped normals nearly all do
EYES, ORTHOGRAPHIC_EYES = 6, 2


def verify_artifacts(
    mesh: Tensors,
    hull: Tensors | None,
    maps: Tensors | None,
    tree: Tensors | None,
    progress: Callable[[float], None],
) -> dict[str, Any]:
    """Check the tensors of `schemas.artifacts` MESH, HULL, MAPS and TREE (None where the mesh has none) against each other.

    Returns the stage's report: {checks: {name: seconds}, ...facts: volume_excess, grazing_points, texels_facing_away}.
    Raises CorruptArtifactError at the first fault: the message says what is wrong, `where` has artifact, check and place.
    """
    checks: list[Check] = [("mesh", lambda: _check_mesh(mesh))]
    if "edge_vertices" in mesh:
        checks.append(("edges", lambda: check_edges(mesh)))
    if hull is not None:
        checks += _hull_checks(mesh, hull, maps)
    if tree is not None:
        checks += [("tree", lambda: check_tree(mesh, tree)), ("eyes", lambda: _check_eyes(mesh, tree))]
    seconds: dict[str, float] = {}
    facts: dict[str, Any] = {}
    for done, (name, check) in enumerate(checks):
        progress(done / len(checks))
        started = time.perf_counter()
        facts |= check() or {}
        seconds[name] = round(time.perf_counter() - started, 4)
    progress(1.0)
    return {"checks": seconds, **facts}


def verify_hull(mesh: Tensors, hull: Tensors, maps: Tensors) -> dict[str, Any]:
    """The same checks of one hull and its maps against a mesh that has passed its own: volume_excess, grazing_points, ...

    Raises CorruptArtifactError.
    """
    facts: dict[str, Any] = {}
    for _, check in _hull_checks(mesh, hull, maps):
        facts |= check() or {}
    return facts


def _hull_checks(mesh: Tensors, hull: Tensors, maps: Tensors | None) -> list[Check]:
    checks: list[Check] = [("hull", lambda: _check_hull(mesh, hull)), ("enclosure", lambda: _check_enclosure(mesh, hull))]
    return checks if maps is None else [*checks, ("maps", lambda: _check_maps(hull, maps))]


def _require(holds: bool | np.bool_, artifact: str, check: str, message: str, **where: Any) -> None:
    if not holds:
        raise CorruptArtifactError(f"the {artifact} is wrong: {message}", artifact=artifact, check=check, **where)


def _first(faulty: Values) -> int | None:
    """Index of the first true row of (n,) bool, None where all are false."""
    index = int(np.argmax(faulty)) if len(faulty) else 0
    return index if len(faulty) and faulty[index] else None


def _none(faulty: Any, artifact: str, check: str, message: str, place: str) -> None:
    index = _first(faulty)
    _require(index is None, artifact, check, message, **{place: index})


def check_surface(surface: Tensors, artifact: str) -> None:
    """Finite positions, faces of vertices that are there. Raises CorruptArtifactError."""
    positions, faces = surface["positions"], surface["faces"]
    _require(len(faces) > 0, artifact, "faces", "it has no faces")
    _none(~np.isfinite(positions).all(axis=1), artifact, "finite", "a position is not finite", "vertex")
    _none(((faces < 0) | (faces >= len(positions))).any(axis=1), artifact, "indices", "a face has a vertex that is not there", "face")


def _check_normals(surface: Tensors, artifact: str) -> None:
    length = np.linalg.norm(surface["normals"].astype(np.float64), axis=1)
    _none(~(np.abs(length - 1.0) <= UNIT_SLACK), artifact, "normals", "a vertex normal is not of unit length", "vertex")


def _check_shading(mesh: Tensors) -> None:
    """Every corner of a face has a normal that belongs to the corner's vertex."""
    rows, count = mesh.get("corner_normals", mesh["faces"]), len(mesh["normals"])
    _none(((rows < 0) | (rows >= count)).any(axis=1), "mesh", "shading", "a corner has a normal that is not there", "face")
    vertices = mesh.get("normal_vertices", np.arange(count, dtype=np.int32))
    _none((vertices[rows] != mesh["faces"]).any(axis=1), "mesh", "shading", "a corner has the normal of another vertex", "face")


def _check_mesh(mesh: Tensors) -> None:
    check_surface(mesh, "mesh")
    _check_normals(mesh, "mesh")
    _check_shading(mesh)
    radius = np.linalg.norm(mesh["positions"].astype(np.float64), axis=1)
    _none(radius > 1.0 + FRAME_SLACK, "mesh", "frame", "a vertex lies outside the unit sphere of the normalised frame", "vertex")


def check_edges(mesh: Tensors) -> None:
    """Every half-edge of the faces is in the edge table once: forward with its left face, backward with its right face.

    Raises CorruptArtifactError.
    """
    vertices, sides, faces = mesh["edge_vertices"], mesh["edge_faces"], mesh["faces"]
    _require(2 * len(vertices) == 3 * len(faces), "mesh", "edges", "a closed mesh of f faces has 3 f / 2 edges")
    _none(((sides < 0) | (sides >= len(faces))).any(axis=1), "mesh", "edges", "an edge has a face that is not there", "edge")
    half = np.concatenate([_half_edges(faces, sides[:, 0], vertices), _half_edges(faces, sides[:, 1], vertices[:, ::-1])])
    _none(half < 0, "mesh", "edges", "an edge is not one of its face's, in its direction", "entry")
    _none(np.bincount(half, minlength=3 * len(faces)) != 1, "mesh", "edges", "an edge is there twice", "half_edge")


def _half_edges(faces: Values, face: Values, edges: Values) -> Values:
    """(n,) number of the half-edge of each face that is the directed edge; -1 where it has none such."""
    number = np.full(len(edges), -1, np.int64)
    for k in range(3):
        same = (faces[face, k] == edges[:, 0]) & (faces[face, (k + 1) % 3] == edges[:, 1])
        number[same] = 3 * face[same].astype(np.int64) + k
    return number


def _check_hull(mesh: Tensors, hull: Tensors) -> dict[str, Any]:
    """Closed, oriented, without degenerate faces, not smaller than the original."""
    check_surface(hull, "hull")
    _check_normals(hull, "hull")
    positions, faces = hull["positions"], hull["faces"]
    try:
        build_edges(faces)
    except NotManifoldError as error:
        _require(False, "hull", "closed", "it is not closed and oriented", edge=error.edges[0].tolist())
    flat = verify_enclosure.without_area(positions, faces)
    _none(flat, "hull", "degenerate", "a face has no area", "face")
    original = signed_volume(mesh["positions"], mesh["faces"])
    gained = signed_volume(positions, faces) - original
    _require(gained >= -VOLUME_SLACK * abs(original), "hull", "volume", "it is smaller than the original", gained=gained)
    return {"volume_excess": gained / original if original > 0.0 else None}


def _check_enclosure(mesh: Tensors, hull: Tensors) -> dict[str, Any]:
    try:
        grazing = enclosure_fault(mesh["positions"], mesh["faces"], hull["positions"], hull["faces"])
    except NotEnclosedError as fault:
        _require(False, "hull", "enclosure", str(fault), distance=fault.distance, point=fault.point)
        raise
    except UnprovenError as fault:
        _require(False, "hull", "enclosure", str(fault))
        raise
    return {"grazing_points": grazing}


def _check_maps(hull: Tensors, maps: Tensors) -> dict[str, Any]:
    """Tiles where the layout has them, unit normals that mostly face outwards, a colour map of the same size."""
    tile_uv, normal, faces = maps["tile_uv"], maps["normal"], hull["faces"]
    _require(len(tile_uv) == len(faces), "maps", "tiles", "there is not one tile for every hull face")
    _none(~np.isfinite(tile_uv).all(axis=(1, 2)), "maps", "tiles", "a texture coordinate is not finite", "face")
    height, width = normal.shape[:2]
    layout = TileLayout.of(tile_uv, width, height)
    rows = -(-((layout.faces + 1) // 2) // max(1, layout.columns))
    fits = layout.side >= 1 and layout.columns >= 1 and rows * (layout.side + 2) <= height
    _require(fits, "maps", "tiles", "the tiles do not fit the map", side=layout.side, width=width, height=height)
    _none(~_tiles_in_place(layout, tile_uv), "maps", "tiles", "a tile is not where its face's tile lies", "face")
    if "color" in maps:
        _require(maps["color"].shape[:2] == (height, width), "maps", "color", "the colour map has another size than the normal map")
    across = face_normals(hull["positions"], faces)
    bad, away, where = verify_maps.texel_faults(normal, across, layout.side, layout.columns, TEXEL_SLACK)
    _require(bad == 0, "maps", "normals", "a texel holds no unit normal", face=where, texels=bad)
    share = away / (len(faces) * (layout.side + 1) * (layout.side + 2) / 2.0)
    _require(share <= MOST_AWAY, "maps", "facing", "the normals face into the hull", share=round(share, 3))
    return {"texels_facing_away": round(share, 5)}


def _tiles_in_place(layout: TileLayout, tile_uv: Values) -> Values:
    """(hf,) bool: the tile lies in its cell, with its right angle at one of the three corners."""
    good = np.zeros(layout.faces, np.bool_)
    for turn in range(3):
        there = layout.tile_uv(np.full(layout.faces, turn, np.int32))
        good |= np.abs(there.astype(np.float64) - tile_uv).max(axis=(1, 2)) <= 1e-6
    return good


def check_tree(mesh: Tensors, tree: Tensors) -> None:
    """Preorder and edge lists in order, every cone inside the half-spaces of all faces under it. Raises CorruptArtifactError."""
    skip, start, index = tree["skip"], tree["edge_start"], tree["edge_index"]
    nodes, edges = len(skip), len(mesh["edge_vertices"])
    where = int(verify_tree.unnested_node(skip))
    _require(where < 0, "tree", "preorder", "a node does not skip to the end of a nested subtree", node=where)
    ordered = len(start) == nodes + 1 and start[0] == 0 and start[-1] == len(index) and bool(np.all(np.diff(start) >= 0))
    _require(ordered, "tree", "edge-lists", "the nodes do not share out the edges in order")
    _none((index < 0) | (index >= edges), "tree", "edge-lists", "an edge is not one of the mesh's", "entry")
    missing = _first(np.bincount(index, minlength=edges) != 1)
    _require(missing is None, "tree", "edge-lists", "an edge is not in exactly one node", edge=missing)
    scaled, front, back, separation = (tree[name] for name in ("scaled_normal", "front_anchor", "back_anchor", "separation"))
    finite = np.isfinite(np.hstack([scaled, front, back])).all(axis=1) & np.isfinite(separation)
    _none(np.logical_not(finite), "tree", "cones", "a cone is not finite", "node")
    surface = (mesh["positions"], mesh["faces"], mesh["edge_faces"])
    where = int(verify_tree.unsound_node(surface, (scaled, front, back, separation), skip, start, index))
    _require(where < 0, "tree", "cones", "a cone could cull a silhouette edge", node=where)


def _sampled_eyes() -> F8:
    rng = np.random.default_rng(20000723)
    towards = rng.normal(size=(EYES + ORTHOGRAPHIC_EYES, 3))
    towards /= np.linalg.norm(towards, axis=1, keepdims=True)
    towards[:EYES] *= np.geomspace(1.05, 20.0, EYES)[:, None]
    return np.column_stack([towards, np.arange(len(towards)) < EYES]).astype(np.float64)


def _check_eyes(mesh: Tensors, tree: Tensors) -> dict[str, Any]:
    """At sampled eyes: the walk reaches every silhouette edge, and those edges make closed contours."""
    sides, vertices = mesh["edge_faces"], mesh["edge_vertices"]
    cones = tuple(tree[name] for name in ("scaled_normal", "front_anchor", "back_anchor", "separation"))
    reached_share = []
    for number, eye in enumerate(_sampled_eyes()):
        front = front_facing(mesh["positions"], mesh["faces"], eye)
        left, right = front[sides[:, 0]], front[sides[:, 1]]
        reached = np.zeros(len(vertices), np.bool_)
        verify_tree.reached_edges(cones, tree["skip"], tree["edge_start"], tree["edge_index"], eye, reached)
        _none((left != right) & ~reached, "tree", "eyes", "a culled node has a silhouette edge", "edge")
        contour = np.concatenate([vertices[left & ~right], vertices[right & ~left][:, ::-1]])
        unbalanced = _first(_degrees(contour[:, 0], mesh) != _degrees(contour[:, 1], mesh))
        _require(unbalanced is None, "mesh", "contours", "a silhouette is not closed", eye=number, vertex=unbalanced)
        reached_share.append(float(reached.mean()))
    return {"tested_edges": round(float(np.mean(reached_share)), 4)}


def _degrees(ends: Values, mesh: Tensors) -> Values:
    return np.bincount(ends, minlength=len(mesh["positions"])).astype(np.int32)
