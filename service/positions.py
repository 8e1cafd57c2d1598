"""Positions of vertices as clients send them: bare float32, or a file of numpy."""

from __future__ import annotations

import math
from pathlib import Path
from typing import BinaryIO

import numpy as np

from schemas.conventions import Array
from schemas.errors import InvalidRequestError
from service.moving import FIELD

MAGIC = b"\x93NUMPY"
HEADER_BYTES = 10_000
"""Of numpy's files: a longer header is none of ours."""
HEADERS = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}
DTYPES = ("<f4", "<f8")


def poses_in(path: Path, vertices: int) -> Array:
    """(k, v, 3) f4 or f8, mapped: the positions of k poses of a mesh of so many vertices, in model units.

    A file is k * v * 3 little-endian float32, or an .npy file of float32 or float64 of the shape (v, 3) or (k, v, 3).
    Raises InvalidRequestError, with the numbers that there are and should be.
    """
    size = path.stat().st_size
    with path.open("rb") as file:
        if file.read(len(MAGIC)) == MAGIC:
            return _mapped(path, *_header(file, vertices), vertices)
    if not size or size % (12 * vertices):
        given = f"{size:,} bytes, of {size / (12 * vertices):.6g} poses"
        raise _wrong(f"a pose of {vertices:,} vertices has {12 * vertices:,} bytes, three float32 a vertex; there are {given}", vertices)
    return np.memmap(path, "<f4", "r", shape=(size // (12 * vertices), vertices, 3))


def _header(file: BinaryIO, vertices: int) -> tuple[np.dtype, tuple[int, ...], int]:
    """(dtype, shape, offset of the data) of numpy's file."""
    file.seek(0)
    try:
        version = np.lib.format.read_magic(file)
        read = HEADERS.get(version)
        shape, fortran, dtype = read(file, max_header_size=HEADER_BYTES) if read else ((), False, np.dtype(DTYPES[0]))
    except Exception as error:  # numpy reads the header as Python, and lets out whatever its parsers raise
        raise _wrong("that is no whole file of numpy", vertices) from error
    if read is None:
        raise _wrong(f"numpy's file is of version {version[0]}.{version[1]}; 1.0 and 2.0 are read", vertices)
    if dtype.str not in DTYPES or fortran:
        what = "columns one after the other" if fortran else dtype.str
        raise _wrong(f"positions are float32 or float64, little-endian, in rows; these are {what}", vertices)
    return dtype, shape, file.tell()


def _mapped(path: Path, dtype: np.dtype, shape: tuple[int, ...], offset: int, vertices: int) -> Array:
    if len(shape) not in (2, 3) or shape[-2:] != (vertices, 3) or not all(shape):
        raise _wrong(f"the mesh has {vertices:,} vertices: an array is (vertices, 3) or (poses, vertices, 3); this is {shape}", vertices)
    if path.stat().st_size != offset + dtype.itemsize * math.prod(shape):
        raise _wrong("that is no whole file of numpy", vertices)
    poses = np.memmap(path, dtype, "r", offset, shape)
    return poses if len(shape) == 3 else poses[None]


def _wrong(message: str, vertices: int) -> InvalidRequestError:
    return InvalidRequestError(message, field=FIELD, vertices=vertices)
