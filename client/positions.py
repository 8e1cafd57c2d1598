"""Vertices on their way to and from the service: positions of a mesh as a file, and those of `original.glb`."""

from __future__ import annotations

import io
import json
import struct
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
import numpy.typing as npt

from schemas.artifacts import FILE_VERTEX

Positions = npt.ArrayLike | Path
"""Of vertices, or of those of each frame: an array (v, 3) or (k, v, 3), or a file of it: .npy, or bare little-endian float32."""
HEAD_BYTES, CHUNK_HEAD_BYTES = 12, 8
"""Of a binary glTF, and of its two parts."""


@dataclass(frozen=True)
class Original:
    """A mesh as the service has it. positions: (v, 3) f8 model units. faces: (f, 3) i4. file_vertices: (v,) i8, the number of each vertex
    in the file that was uploaded, -1 where it had none; None where the service does not know.
    """

    positions: npt.NDArray[np.float64]
    faces: npt.NDArray[np.int32]
    file_vertices: npt.NDArray[np.int64] | None = None

    def ordered(self, positions: npt.ArrayLike) -> npt.NDArray[Any]:
        """(..., v, 3): positions (..., n, 3) of the file's vertices as those of the mesh; what the file has not stays where it is.

        Raises ValueError when the file's vertices are not known, or there are fewer positions than it has.
        """
        if self.file_vertices is None:
            raise ValueError("the service does not know the vertices of the file; upload it again")
        given = np.asarray(positions)
        if given.ndim < 2 or given.shape[-1] != 3 or given.shape[-2] <= self.file_vertices.max(initial=-1):
            needed = int(self.file_vertices.max(initial=-1)) + 1
            raise ValueError(f"the file has at least {needed:,} vertices, but positions are an array of {given.shape}")
        own = (self.file_vertices < 0)[:, None]
        return np.where(own, self.positions.astype(given.dtype), given[..., self.file_vertices, :])


def original_of(glb: bytes) -> Original:
    """The vertices and faces of an `original.glb`, in its order. Raises ValueError for other files."""
    length, kind = struct.unpack_from("<I4s", glb, HEAD_BYTES)
    if glb[:4] != b"glTF" or kind != b"JSON":
        raise ValueError("that is no binary glTF")
    start = HEAD_BYTES + CHUNK_HEAD_BYTES
    document = json.loads(glb[start : start + length])
    data = glb[start + length + CHUNK_HEAD_BYTES :]
    primitive, node = document["meshes"][0]["primitives"][0], document["nodes"][0]
    positions = _accessor(document, data, primitive["attributes"]["POSITION"], "<f4")
    faces = _accessor(document, data, primitive["indices"], "<u4")
    moved = positions.reshape(-1, 3).astype(np.float64) * np.array(node["scale"]) + np.array(node["translation"])
    numbers = None
    if FILE_VERTEX in primitive["attributes"]:
        numbers = _accessor(document, data, primitive["attributes"][FILE_VERTEX], "<f4").astype(np.int64)
    return Original(moved, faces.reshape(-1, 3).astype(np.int32), numbers)


def _accessor(document: dict[str, Any], data: bytes, number: int, dtype: str) -> npt.NDArray[Any]:
    view = document["bufferViews"][document["accessors"][number]["bufferView"]]
    return np.frombuffer(data, dtype, view["byteLength"] // 4, view["byteOffset"])


@contextmanager
def opened(positions: Positions) -> Iterator[BinaryIO]:
    """Positions as a file to be sent, float32 as they are and all else as float64. Raises OSError, ValueError for what are no numbers."""
    if isinstance(positions, Path):
        with positions.open("rb") as file:
            yield file
        return
    array = np.asarray(positions)
    out = io.BytesIO()
    np.save(out, np.ascontiguousarray(array, "<f4" if array.dtype == np.float32 else "<f8"), allow_pickle=False)
    out.seek(0)
    yield out
