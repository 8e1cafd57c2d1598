"""Stage "load": hostile bytes in, a clean indexed mesh in the normalised frame out."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from geometry.shading import ShadingNormals, shading_normals
from geometry.topology import EdgeTable, face_components
from schemas.conventions import F4, I4, Array, Frame
from schemas.mesh import Capability, MeshStats, PreprocessOptions
from worker.loading.faults import rejected
from worker.loading.limits import LoadLimits
from worker.loading.parsed import Parsed
from worker.loading.repair import drop_no_faces, edges_and_clip, repair
from worker.loading.sandbox import parse_limited
from worker.loading.sniff import normal_extension
from worker.loading.surface import Surface
from worker.loading.weld import weld

Progress = Callable[[float], None]


@dataclass(frozen=True)
class LoadedMesh:
    """A mesh ready for the later stages.

    positions (v, 3) f4 normalised; faces (f, 3) i4; shading: its normals, two or more at the vertices of creases; edges: the
    edge table, or None where the mesh is not closed and oriented; appearance: the tensors of artifacts.APPEARANCE, or None
    where the file has no colour; repairs: what loading changed, as plain JSON. file_vertices: (v,) i4 as in artifacts.FILE_VERTICES.
    """

    frame: Frame
    positions: F4
    faces: I4
    shading: ShadingNormals
    edges: EdgeTable | None
    appearance: dict[str, Array] | None
    stats: MeshStats
    clip: Capability
    repairs: dict[str, Any]
    file_vertices: I4


def _silent(_: float) -> None:
    return None


DEFAULT_LIMITS = LoadLimits()


def load_mesh(
    path: Path, extension: str, options: PreprocessOptions, limits: LoadLimits = DEFAULT_LIMITS, progress: Progress = _silent
) -> LoadedMesh:
    """Load an upload of the format its extension names.

    Raises UnknownFormatError, MeshRejectedError (its code is one of `worker.loading.faults.CODES`) or TooLargeError.
    """
    kind = normal_extension(extension)
    progress(0.0)
    if options.max_faces is not None:
        limits = replace(limits, max_faces=min(limits.max_faces, options.max_faces))
    parsed = parse_limited(path, kind, limits)
    progress(0.5)
    return build(parsed, options, progress)


def build(parsed: Parsed, options: PreprocessOptions, progress: Progress = _silent) -> LoadedMesh:
    """The mesh of a parsed file: everything after parsing. Raises MeshRejectedError."""
    repairs: dict[str, Any] = dict(parsed.notes)
    frame, surface = _framed(parsed, repairs)
    surface = drop_no_faces(surface, repairs)
    if options.repair == "auto":
        surface = repair(surface, repairs, lambda part: progress(0.5 + 0.4 * part))
        if repairs["kept_zero_area_faces"] == len(surface.faces):
            raise rejected("no-faces", "No face of the mesh has any area.")
    surface, _ = surface.compact()
    edges, clip = edges_and_clip(surface)
    progress(0.95)
    faces = np.ascontiguousarray(surface.faces, np.int32)
    shading = shading_normals(surface.positions, faces)
    stats = _stats(frame, surface, edges)
    progress(1.0)
    appearance, numbers = _appearance(parsed, surface.corners), _file_vertices(parsed, frame, surface)
    return LoadedMesh(frame, surface.positions, faces, shading, edges, appearance, stats, clip, repairs, numbers)


def _framed(parsed: Parsed, repairs: dict[str, Any]) -> tuple[Frame, Surface]:
    used = np.zeros(len(parsed.positions), bool)
    used[parsed.faces] = True
    points = parsed.positions[used]
    try:
        with np.errstate(over="ignore"):
            frame = Frame.around(points)
    except ValueError:
        raise rejected("no-extent", "All vertices of the mesh are at the same point.") from None
    if not np.isfinite(frame.scale):
        raise rejected("non-finite-vertices", "The coordinates of the mesh are too large.")
    normalised = frame.to_normalised(points).astype(np.float32)
    kept, number = weld(normalised)
    index = np.cumsum(used) - 1
    corners = np.arange(3 * len(parsed.faces)).reshape(-1, 3)
    surface = Surface(normalised[kept], number[index[parsed.faces]], corners)
    repairs["removed_unreferenced_vertices"] = int(len(used) - used.sum())
    repairs["welded_vertices"] = len(points) - len(kept)
    return frame, surface


def _appearance(parsed: Parsed, corners: Array) -> dict[str, Array] | None:
    if not parsed.appearance:
        return None
    taken: dict[str, Array] = {}
    for name, tensor in parsed.appearance.items():
        flat = tensor.reshape(-1, tensor.shape[-1]) if name.startswith("corner") else tensor
        taken[name] = np.ascontiguousarray(flat[corners] if name.startswith("corner") else flat)
    return taken


def _file_vertices(parsed: Parsed, frame: Frame, surface: Surface) -> I4:
    """(v,) i4: which vertex of the file each vertex is: the one at its first corner, or where that was another one, one at its place."""
    with np.errstate(over="ignore", invalid="ignore"):
        placed = frame.to_normalised(parsed.positions).astype(np.float32)
    found = np.empty(len(surface.positions), np.int64)
    found[surface.faces.reshape(-1)[::-1]] = parsed.faces.reshape(-1)[surface.corners.reshape(-1)[::-1]]
    other = np.flatnonzero((placed[found] != surface.positions).any(axis=1))
    if len(other):
        first, number = weld(np.concatenate([placed, surface.positions[other]]))
        there = first[number[len(placed) :]]
        found[other] = np.where(there < len(placed), there, -1)
    return found.astype(np.int32)


def _stats(frame: Frame, surface: Surface, edges: EdgeTable | None) -> MeshStats:
    table = surface.edges
    _, components = face_components(surface.faces.astype(np.int32), len(surface.positions))
    model = frame.to_model(surface.positions)
    return MeshStats(
        vertices=len(surface.positions),
        faces=len(surface.faces),
        edges=len(table.counts),
        components=int(components),
        closed=edges is not None,
        oriented=not (table.balances[table.counts == 2]).any(),
        bounds=[model.min(axis=0).tolist(), model.max(axis=0).tolist()],
    )
