"""Vertices, their colours and faces of an OBJ file. Runs only in the limited child.

An upload is one file, so materials and textures are never there and only these lines matter. trimesh's reader of them is not
used: it takes relative indices from the end of the whole file, and fails on tabs, comments behind values and polygons of
equally many corners.
"""

from __future__ import annotations

from array import array
from itertools import pairwise
from typing import Any

import numpy as np

from worker.loading.faults import rejected
from worker.loading.limits import LoadLimits


def read_obj(data: bytes, limits: LoadLimits) -> dict[str, Any]:
    """{"vertices" (v, 3) f8, "faces" (f, 3) i8, "vertex_colors" (v, 3) f8 or None}; polygons are cut into fans.

    Raises MeshRejectedError naming the line.
    """
    vertices, colors, faces = array("d"), array("d"), array("q")
    text = data.decode("latin-1").replace("\\\r\n", " ").replace("\\\n", " ").replace("\r\n", "\n").replace("\r", "\n")
    for number, line in enumerate(text.split("\n"), start=1):
        words = (line.partition("#")[0] if "#" in line else line).split()
        if not words:
            continue
        try:
            if words[0] == "v":
                vertices.extend(map(float, words[1:4]))
                if len(words) >= 7:
                    colors.extend(map(float, words[4:7]))
                elif len(words) < 4:
                    raise _wrong(number)
            elif words[0] == "f":
                _face(faces, words, len(vertices) // 3, number)
        except ValueError:
            raise _wrong(number) from None
        if len(faces) > 3 * limits.max_faces or len(vertices) > 3 * limits.max_vertices:
            break  # the caller counts, and refuses
    points = np.frombuffer(vertices, np.float64).reshape(-1, 3)
    shades = np.frombuffer(colors, np.float64).reshape(-1, 3) if len(colors) == len(vertices) else None
    return {"vertices": points, "faces": np.frombuffer(faces, np.int64).reshape(-1, 3), "vertex_colors": shades}


def _wrong(line: int) -> Exception:
    return rejected("parse-failed", f"Line {line} of the OBJ file cannot be read.", line=line)


def _face(faces: array[int], words: list[str], vertices: int, line: int) -> None:
    corners = [int(word.partition("/")[0]) for word in words[1:]]
    if len(corners) < 3:
        raise rejected("parse-failed", f"Line {line} of the OBJ file is a face of fewer than three corners.", line=line)
    for i, corner in enumerate(corners):
        if corner == 0 or corner < -vertices or corner > 1 << 40:
            raise rejected("index-out-of-range", f"Line {line} of the OBJ file names a vertex that does not exist.", line=line)
        corners[i] = corner - 1 if corner > 0 else vertices + corner
    for second, third in pairwise(corners[1:]):
        faces.extend((corners[0], second, third))
