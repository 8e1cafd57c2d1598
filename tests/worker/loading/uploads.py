"""Files of every format as bytes, made from built meshes, and ways to load bytes."""

from __future__ import annotations

import io
import struct
import zipfile

import numpy as np
import trimesh

from schemas.mesh import PreprocessOptions
from worker.load import build, load_mesh
from worker.loading.limits import LoadLimits
from worker.loading.parse import parse
from worker.loading.parsed import Parsed

FORMATS = ("stl", "stl_ascii", "obj", "ply", "ply_ascii", "off", "glb", "3mf")
LIMITS = LoadLimits()


def extension(kind: str) -> str:
    return kind.partition("_")[0]


def as_bytes(mesh, kind: str) -> bytes:
    """(vertices, faces) as a file of `kind`, one of FORMATS."""
    vertices, faces = mesh
    solid = trimesh.Trimesh(vertices, faces, process=False)
    with np.errstate(all="ignore"):
        data = solid.export(file_type="ply", encoding="ascii") if kind == "ply_ascii" else solid.export(file_type=kind)
    return data.encode() if isinstance(data, str) else bytes(data)


def loaded(tmp_path, data: bytes, kind: str, limits: LoadLimits = LIMITS, **options):
    """Through the limited child."""
    path = tmp_path / "upload"
    path.write_bytes(data)
    return load_mesh(path, extension(kind), PreprocessOptions(**options), limits)


def parsed(data: bytes, kind: str, limits: LoadLimits = LIMITS) -> Parsed:
    """In this process: what the child does."""
    return parse(extension(kind), data, limits)


def built(mesh, **options):
    """A mesh given as arrays, through everything after parsing."""
    vertices, faces = mesh
    return build(Parsed(np.asarray(vertices, np.float64), np.asarray(faces, np.int32), {}), PreprocessOptions(**options))


def glb(tree_json: bytes, binary: bytes = b"") -> bytes:
    """A GLB file of a JSON chunk and a binary chunk."""
    tree = tree_json + b" " * (-len(tree_json) % 4)
    chunks = struct.pack("<II", len(tree), 0x4E4F534A) + tree
    if binary:
        binary += b"\0" * (-len(binary) % 4)
        chunks += struct.pack("<II", len(binary), 0x004E4942) + binary
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks


def archive(members: dict[str, bytes]) -> bytes:
    """A ZIP file."""
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as file:
        for name, data in members.items():
            file.writestr(zipfile.ZipInfo(name), data, zipfile.ZIP_DEFLATED)  # of no time: the same bytes whenever it is made
    return out.getvalue()
