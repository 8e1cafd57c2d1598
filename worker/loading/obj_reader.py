"""Vertices, their colours and faces of an OBJ file. Runs only in the limited child.

An upload is one file, so materials and textures are never there and only these lines matter. trimesh's reader of them is not
used: it takes relative indices from the end of the whole file, and fails on tabs, comments behind values and polygons of
equally many corners.
"""

from __future__ import annotations

import io
from array import array
from collections.abc import Iterator
from itertools import pairwise
from typing import Any

import numpy as np

from schemas.errors import MeshRejectedError
from worker.loading.faults import rejected
from worker.loading.limits import LoadLimits


def read_obj(data: bytes, limits: LoadLimits) -> dict[str, Any]:
    """{"vertices" (v, 3) f8, "faces" (f, 3) i8, "vertex_colors" (v, 3) f8 or None}; polygons are cut into fans.

    Raises MeshRejectedError naming the line.
    """
    vertices, colors, faces = array("d"), array("d"), array("q")
    if b"\n" not in data:
        data = data.replace(b"\r", b"\n")
    last = data.count(b"\n") + 1  # a file that ends as it should has nothing on this line
    for number, line in _lines(data):
        words = line.split()
        if not words or words[0] not in (b"v", b"f"):
            continue
        try:
            if words[0] == b"v":
                x, y, z = map(float, words[1:4])
                vertices.extend((x, y, z))
                colors.extend(map(float, words[4:7]) if len(words) >= 7 else ())
            else:
                _face(faces, words, len(vertices) // 3, number)
        except (ValueError, OverflowError):
            raise _unreadable(number, number == last) from None
        if len(faces) > 3 * limits.max_faces or len(vertices) > 3 * limits.max_vertices:
            break  # the caller counts, and refuses
    points = np.frombuffer(vertices, np.float64).reshape(-1, 3)
    shades = np.frombuffer(colors, np.float64).reshape(-1, 3) if len(colors) == len(vertices) else None
    return {"vertices": points, "faces": np.frombuffer(faces, np.int64).reshape(-1, 3), "vertex_colors": shades}


def _lines(data: bytes) -> Iterator[tuple[int, bytes]]:
    """(number of its last line, text without comment) of each statement; a backslash joins a line to the next."""
    held = b""
    for number, line in enumerate(io.BytesIO(data), start=1):
        text = held + (line.partition(b"#")[0] if b"#" in line else line)
        if text.endswith((b"\\\n", b"\\\r\n")):
            held = text.rstrip(b"\r\n")[:-1] + b" "
            continue
        held = b""
        yield number, text


def _unreadable(line: int, last: bool) -> MeshRejectedError:
    if last:
        return rejected("truncated", f"The OBJ file breaks off in line {line}.", line=line)
    return rejected("parse-failed", f"Line {line} of the OBJ file is no vertex or no face of three or more corners.", line=line)


def _face(faces: array[int], words: list[bytes], vertices: int, line: int) -> None:
    """Append the triangles of a face line; ValueError when it is none."""
    first, *others = [int(word.partition(b"/")[0]) for word in words[1:]]
    if len(others) < 2:
        raise ValueError(words)
    corners = [corner - 1 if corner > 0 else vertices + corner for corner in (first, *others)]
    if 0 in (first, *others) or min(corners) < 0 or max(corners) > 1 << 40:
        raise rejected("index-out-of-range", f"Line {line} of the OBJ file names a vertex that does not exist.", line=line)
    for second, third in pairwise(corners[1:]):
        faces.extend((corners[0], second, third))
