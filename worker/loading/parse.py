"""Checked bytes to plain arrays, through trimesh's readers. Runs only in the limited child."""

from __future__ import annotations

import io
import re
import warnings
from typing import Any

import numpy as np

from schemas.conventions import F8
from schemas.errors import SilhouetteError, TooLargeError
from worker.loading import sniff
from worker.loading.faults import parse_failed, rejected
from worker.loading.headers import glb, ply
from worker.loading.limits import LoadLimits
from worker.loading.obj_reader import read_obj
from worker.loading.off_reader import read_off
from worker.loading.parsed import I8, Parsed, Piece


def parse(extension: str, data: bytes, limits: LoadLimits) -> Parsed:
    """Read bytes of a known format.

    Raises MeshRejectedError for what is wrong in them and TooLargeError beyond the limits.
    """
    sniff.check(extension, data, limits)
    from worker.loading.colors import collect

    kind = sniff.normal_extension(extension)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        # numpy stops at the first word that is no number and only warns
        warnings.filterwarnings("error", message=".*string or file could not be read to its end.*")
        try:
            raw = _read(kind, data, limits)
            pieces = _some([p for p in _pieces(raw, limits) if len(p.faces)])
            appearance, notes = collect(pieces, kind, limits)
        except (SilhouetteError, MemoryError):
            raise
        except Exception:
            raise parse_failed(kind.upper()) from None
    starts = np.cumsum([0] + [len(p.vertices) for p in pieces])
    positions = np.concatenate([p.vertices for p in pieces])
    faces = np.concatenate([p.faces + start for p, start in zip(pieces, starts, strict=False)])
    return Parsed(positions, faces.astype(np.int32), appearance, notes | _references(kind, data))


def _some(pieces: list[Piece]) -> list[Piece]:
    if not pieces:
        raise rejected("no-faces", "The file has no faces.")
    return pieces


def _read(kind: str, data: bytes, limits: LoadLimits) -> dict[str, Any]:
    """The reader's own description: one geometry, or {"geometry": {name: ...}, "graph": [...]}."""
    if kind == "obj":
        return read_obj(data, limits)
    if kind == "off":
        return read_off(data, limits)
    stream = io.BytesIO(data)
    if kind == "stl":
        from trimesh.exchange import stl

        return stl.load_stl(stream)
    if kind == "ply":
        from trimesh.exchange import ply as ply_reader

        return _read_ply(ply_reader.load_ply(stream, resolver=None, skip_materials=True), ply.read_header(data))
    from trimesh.exchange import load

    raw = load.mesh_loaders[kind](file_obj=stream, file_type=kind, resolver=None)
    return _with_colors(raw, data) if kind == "3mf" else raw


def _with_colors(raw: dict[str, Any], data: bytes) -> dict[str, Any]:
    """A 3MF description with the colours of its objects, where the reader told the same objects apart."""
    from worker.loading.threemf_colors import corner_colors

    colors, parts = corner_colors(data), list(raw.get("geometry", {}).values())
    if colors is not None and len(colors) == len(parts):
        for part, shades in zip(parts, colors, strict=True):
            if shades is not None and len(shades) == len(part["faces"]):
                part["corner_colors"] = shades
    return raw


def _read_ply(raw: dict[str, Any], header: ply.Header) -> dict[str, Any]:
    """The reader turns a file of triangle strips into points; the strips are decoded here."""
    if raw.get("faces") is None and "tristrips" in header.elements:
        data = raw["metadata"]["_ply_raw"]["tristrips"]["data"]
        rows = data["vertex_indices"]
        rows = rows["f1"] if rows.dtype.names else np.atleast_2d(rows) if rows.dtype != object else rows
        raw["faces"] = np.concatenate([_strip_faces(np.asarray(row, np.int64).ravel()) for row in rows])
    elif raw.get("faces") is not None and len(raw["faces"]) < header.elements["face"].count:
        short = header.elements["face"].count - len(raw["faces"])
        raise rejected("parse-failed", f"{short} faces of the PLY file have fewer than three corners.", faces=short)
    return raw


def _strip_faces(strip: I8) -> I8:
    """(f, 3) i8 faces of triangle strips that -1 separates; every second triangle of a strip is turned round."""
    cut = strip < 0
    start = np.maximum.accumulate(np.where(cut, np.arange(len(strip)) + 1, 0))
    faces = np.column_stack([strip[:-2], strip[1:-1], strip[2:]])
    odd = (np.arange(len(faces)) - start[: len(faces)]) % 2 == 1
    faces[odd] = faces[odd][:, [1, 0, 2]]
    return faces[~(cut[:-2] | cut[1:-1] | cut[2:])]


def _pieces(raw: dict[str, Any], limits: LoadLimits) -> list[Piece]:
    if "geometry" not in raw:
        return [_piece(raw, np.eye(4), limits)]
    if not raw.get("graph"):
        return [_piece(g, np.eye(4), limits) for g in raw["geometry"].values()]
    from trimesh.scene.transforms import SceneGraph

    graph = SceneGraph(base_frame=raw.get("base_frame", "world"))
    for edge in raw["graph"]:
        graph.update(**edge)
    pieces, faces = [], 0
    for node in graph.nodes_geometry:
        matrix, name = graph.get(node)
        if raw["geometry"][name].get("faces") is None:
            continue
        pieces.append(_piece(raw["geometry"][name], matrix, limits))
        faces += len(pieces[-1].faces)
        _cap(faces, "faces", limits.max_faces)
    return pieces


def _piece(raw: dict[str, Any], matrix: F8, limits: LoadLimits) -> Piece:
    faces = raw.get("faces")
    vertices = np.asarray(raw["vertices"], np.float64).reshape(-1, 3)
    if faces is None or not len(faces):
        return Piece(vertices, np.zeros((0, 3), np.int64), raw)
    faces, raw = _triangles(np.asarray(faces).astype(np.int64), raw)
    _cap(len(vertices), "vertices", limits.max_vertices)
    _cap(len(faces), "faces", limits.max_faces)
    bad = np.flatnonzero(((faces < 0) | (faces >= len(vertices))).any(axis=1))
    if len(bad):
        raise rejected(
            "index-out-of-range", f"Face {bad[0]} names a vertex that does not exist; there are {len(vertices)}.", face=int(bad[0])
        )
    if not np.array_equal(matrix, np.eye(4)):
        with np.errstate(all="ignore"):
            vertices = vertices @ matrix[:3, :3].T + matrix[:3, 3]
            mirrored = np.linalg.det(matrix[:3, :3]) < 0.0
        faces = faces[:, ::-1] if mirrored else faces
    used = np.zeros(len(vertices), bool)
    used[faces] = True
    wrong = np.flatnonzero(used & ~np.isfinite(vertices).all(axis=1))
    if len(wrong):
        raise rejected("non-finite-vertices", f"Vertex {wrong[0]} has a coordinate that is not finite.", vertex=int(wrong[0]))
    vertices = np.where(used[:, None], vertices, 0.0) if not np.isfinite(vertices).all() else vertices
    return Piece(vertices, faces, raw)


def _triangles(faces: I8, raw: dict[str, Any]) -> tuple[I8, dict[str, Any]]:
    """Polygons of equally many corners (f, k) cut into fans, each triangle with its polygon's colour."""
    corners = faces.shape[1] if faces.ndim == 2 else 3
    if corners == 3:
        return faces.reshape(-1, 3), raw
    fans = np.stack([faces[:, [0, k, k + 1]] for k in range(1, corners - 1)], axis=1).reshape(-1, 3)
    if raw.get("face_colors") is not None:
        raw = raw | {"face_colors": np.repeat(raw["face_colors"], corners - 2, axis=0)}
    return fans, raw


def _cap(count: int, what: str, limit: int) -> None:
    if count > limit:
        raise TooLargeError(f"The mesh has {count} {what}; {limit} are allowed.", limit=limit, count=count)


def _references(kind: str, data: bytes) -> dict[str, Any]:
    """Notes on files the upload names: they are not there, and nothing is looked up."""
    if kind == "obj" and re.search(rb"^[ \t]*mtllib\s", data, re.MULTILINE):
        return {"ignored_references": "the material library of the OBJ file is not part of the upload"}
    if kind == "ply" and b"TextureFile" in data[: ply.MAX_HEADER]:
        return {"ignored_references": "the texture of the PLY file is not part of the upload"}
    if kind == "glb" and glb.external_images(data):
        return {"ignored_references": "images of the GLB file are not part of the upload"}
    return {}
