"""Artifact files: the safetensors layout, written as a stream and opened as read-only maps.

A file is: length of the header (8 bytes, little-endian), the header (JSON: tensor -> dtype, shape, [begin, end) of its
bytes behind the header; "__metadata__" -> text), the tensors without gaps. What a file must hold is its
`schemas.artifacts.Layout`. The safetensors library checks every file before it is published and again when it is opened;
this module checks what the library cannot know: the layout, the dimensions that belong together, whose file it is.
"""

from __future__ import annotations

import hashlib
import json
import math
import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from safetensors import SafetensorError, safe_open

from backend.store import Store
from schemas import keys
from schemas.artifacts import Layout
from schemas.conventions import U1, Array
from schemas.errors import CorruptArtifactError, DamagedArtifactError

DTYPE_NAMES = {"<f8": "F64", "<f4": "F32", "<i8": "I64", "<i4": "I32", "<u4": "U32", "|u1": "U8"}
DTYPES = {name: dtype for dtype, name in DTYPE_NAMES.items()}
HEADER_LIMIT = 1 << 20  # bytes; ours are below 2000
ALIGNMENT = 8  # bytes, of the first tensor: header and its length are padded to it
METADATA = "__metadata__"
LEAST_MAPPED = 1 << 18
"""Bytes of the smallest file that is mapped: a map keeps its file open, and small meshes have a dozen each."""


@dataclass(frozen=True)
class Header:
    """Checked header of an artifact file. tensors: name -> (dtype, shape, first byte in the file)."""

    identity: str
    sha256: str
    tensors: dict[str, tuple[str, tuple[int, ...], int]]


def identity_of(mesh_id: str, stage: str) -> str:
    """What an artifact says it is: mesh, stage and pipeline version."""
    return f"{mesh_id} {stage} {keys.PIPELINE_VERSION}"


def write_artifact(store: Store, mesh_id: str, layout: Layout, tensors: Mapping[str, Array], identity: str) -> str:
    """Write the artifact `layout.file` of a mesh from its tensors; the sha256 of their contents, hex.

    Raises ValueError when the tensors do not fit the layout, StorageFullError when there is no room. Equal tensors give
    equal bytes.
    """
    arrays = _ordered({name: np.ascontiguousarray(array) for name, array in tensors.items()})
    _check_layout(layout, {name: (array.dtype.str, array.shape) for name, array in arrays.items()}, ValueError)
    digest = content_sha256(arrays)
    key = keys.artifact(mesh_id, layout.file)
    with store.temporary() as file:
        _write(file, arrays, {"identity": identity, "sha256": digest})
        _library_check(Path(file.name))
        store.put_file(key, Path(file.name))
    return digest


def open_artifact(path: Path, layout: Layout, *, identity: str | None = None, verify: bool = False) -> dict[str, Array]:
    """The tensors of an artifact file as read-only views of a memory map, or of what was read of a small file; it lives as long as they do.

    `identity` demands that the file says it is that; `verify` reads it all and compares the sha256.
    Raises CorruptArtifactError.
    """
    header = read_header(path, layout)
    if identity is not None and header.identity != identity:
        raise CorruptArtifactError("an artifact belongs to something else", file=layout.file)
    content = _content(path)
    tensors = {name: _view(content, *place) for name, place in header.tensors.items()}
    if verify and content_sha256(_ordered(tensors)) != header.sha256:
        raise CorruptArtifactError("an artifact's bytes have changed since it was written", file=layout.file)
    return tensors


def read_artifact(store: Store, mesh_id: str, layout: Layout) -> dict[str, Array]:
    """The tensors of a mesh's artifact as `open_artifact` gives them, all bytes compared with the sha256 they were written with.

    Raises NotFoundError, DamagedArtifactError.
    """
    try:
        return store.read_local(keys.artifact(mesh_id, layout.file), lambda path: open_artifact(path, layout, verify=True))
    except CorruptArtifactError as error:
        raise DamagedArtifactError(error.message, **{**error.where, "mesh": mesh_id}) from error


def read_header(path: Path, layout: Layout) -> Header:
    """The header of an artifact file, checked against its layout and the file's size. Raises CorruptArtifactError."""
    try:
        _library_check(path)
        parsed, data_start, size = _parse(path)
        metadata = parsed.pop(METADATA)
        tensors = {name: _place(entry, data_start, size) for name, entry in parsed.items()}
        header = Header(metadata["identity"], metadata["sha256"], tensors)
    except (OSError, SafetensorError, KeyError, TypeError, ValueError) as error:
        raise CorruptArtifactError("an artifact is damaged", file=layout.file) from error
    _check_layout(layout, {name: (dtype, shape) for name, (dtype, shape, _) in tensors.items()}, CorruptArtifactError)
    _check_gapless(header, data_start, size, layout)
    return header


def content_sha256(arrays: Mapping[str, Array]) -> str:
    """Hash of names, dtypes, shapes and bytes, in the order of the file."""
    digest = hashlib.sha256()
    for name, array in arrays.items():
        digest.update(f"{name} {array.dtype.str} {array.shape}\n".encode())
        digest.update(np.ascontiguousarray(array).data.cast("B") if array.size else b"")
    return digest.hexdigest()


def _content(path: Path) -> U1:
    """All bytes of a file, not to be written."""
    if path.stat().st_size >= LEAST_MAPPED:
        return np.memmap(path, np.uint8, mode="r").view(np.ndarray)
    content = np.fromfile(path, np.uint8)
    content.flags.writeable = False
    return content


def _ordered(arrays: Mapping[str, Array]) -> dict[str, Array]:
    """Widest items first, then by name: every tensor is aligned to its item size without gaps."""
    return dict(sorted(arrays.items(), key=lambda item: (-item[1].dtype.itemsize, item[0])))


def _write(file: BinaryIO, arrays: Mapping[str, Array], metadata: dict[str, str]) -> None:
    header: dict[str, Any] = {METADATA: metadata}
    end = 0
    for name, array in arrays.items():
        begin, end = end, end + array.nbytes
        header[name] = {"dtype": DTYPE_NAMES[array.dtype.str], "shape": list(array.shape), "data_offsets": [begin, end]}
    text = json.dumps(header, separators=(",", ":")).encode()
    text += b" " * (-len(text) % ALIGNMENT)
    file.write(len(text).to_bytes(8, "little") + text)
    for array in arrays.values():
        if array.size:
            file.write(array.data.cast("B"))
    file.flush()


def _library_check(path: Path) -> None:
    """Raises SafetensorError when the library refuses the file: header, offsets, gaps, overlaps, size."""
    with safe_open(str(path), framework="numpy"):
        pass


def _parse(path: Path) -> tuple[dict[str, Any], int, int]:
    with path.open("rb") as file:
        size = os.fstat(file.fileno()).st_size
        length = int.from_bytes(file.read(8), "little")
        if length > min(HEADER_LIMIT, size - 8) or length % ALIGNMENT:
            raise ValueError("header length")
        header = json.loads(file.read(length))
    if not isinstance(header, dict):
        raise TypeError("header")
    return header, 8 + length, size


def _place(entry: dict[str, Any], data_start: int, size: int) -> tuple[str, tuple[int, ...], int]:
    dtype = DTYPES[entry["dtype"]]
    shape = tuple(int(side) for side in entry["shape"])
    begin, end = entry["data_offsets"]
    if min(shape, default=0) < 0 or end - begin != math.prod(shape) * np.dtype(dtype).itemsize:
        raise ValueError("shape against offsets")
    if not 0 <= begin <= end <= size - data_start or (data_start + begin) % np.dtype(dtype).itemsize:
        raise ValueError("offsets")
    return dtype, shape, data_start + begin


def _check_layout(layout: Layout, found: Mapping[str, tuple[str, tuple[int, ...]]], error: type[Exception]) -> None:
    missing = layout.tensors.keys() - layout.optional - found.keys()
    unknown = found.keys() - layout.tensors.keys()
    if missing or unknown:
        raise error(f"{layout.file}: missing tensors {sorted(missing)}, unknown tensors {sorted(unknown)}")
    bound: dict[str, int] = {}
    for name, (dtype, shape) in found.items():
        wanted_dtype, wanted_shape = layout.tensors[name]
        if dtype != wanted_dtype or len(shape) != len(wanted_shape):
            raise error(f"{layout.file}: {name} is {dtype} {shape}, not {wanted_dtype} {wanted_shape}")
        for side, wanted in zip(shape, wanted_shape, strict=True):
            expected = wanted if isinstance(wanted, int) else bound.setdefault(wanted, side)
            if side != expected:
                raise error(f"{layout.file}: {name} has a side of {side} where {wanted} is {expected}")


def _check_gapless(header: Header, data_start: int, size: int, layout: Layout) -> None:
    reached = data_start
    for dtype, shape, begin in sorted(header.tensors.values(), key=lambda place: (place[2], math.prod(place[1]))):
        if begin != reached:
            raise CorruptArtifactError("an artifact's tensors leave gaps or overlap", file=layout.file)
        reached = begin + math.prod(shape) * np.dtype(dtype).itemsize
    if reached != size:
        raise CorruptArtifactError("an artifact has bytes behind its tensors", file=layout.file)


def _view(mapped: Array, dtype: str, shape: tuple[int, ...], begin: int) -> Array:
    end = begin + math.prod(shape) * np.dtype(dtype).itemsize
    return mapped[begin:end].view(dtype).reshape(shape)
