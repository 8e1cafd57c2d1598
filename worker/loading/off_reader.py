"""Vertices, faces and the colours of both in an OFF file. Runs only in the limited child.

A vertex is three coordinates, three numbers more for its normal (NOFF), and three or four for its colour (COFF); behind the
corners of a face may come its colour. Colours are from 0 to 255 where one of their kind is greater than 1, else from 0 to 1.
"""

from __future__ import annotations

from array import array
from itertools import pairwise
from typing import Any

import numpy as np

from schemas.conventions import F8, U1
from worker.loading.faults import rejected
from worker.loading.headers import off
from worker.loading.limits import LoadLimits

NO_COLOR = (200.0, 200.0, 200.0, 255.0)
"""Of faces without a colour beside faces that have one, bytes."""


def read_off(data: bytes, limits: LoadLimits) -> dict[str, Any]:
    """{"vertices" (v, 3) f8, "faces" (f, 3) i8, "vertex_colors" (v, 4) u1, "face_colors" (f, 4) u1}, colours only where there are some.

    Polygons are cut into fans. Bytes have passed `off.check`. Raises MeshRejectedError, ValueError.
    """
    kind, lines = off.statements(data)
    vertex_count, face_count = (int(word) for word in lines[0].split()[:2])
    table = _table(lines[1 : vertex_count + 1])
    faces, shades = _faces(lines[vertex_count + 1 : vertex_count + face_count + 1], limits)
    raw: dict[str, Any] = {"vertices": table[:, :3], "faces": faces}
    first = 6 if b"N" in kind else 3
    if b"C" in kind and table.shape[1] - first in (3, 4):
        raw["vertex_colors"] = _bytes_of(table[:, first:])
    if shades is not None:
        raw["face_colors"] = shades
    return raw


def _table(rows: list[bytes]) -> F8:
    """(v, k) f8: the numbers that every row has."""
    words = [row.split() for row in rows]
    width = min(map(len, words))
    if width < 3:
        raise rejected("parse-failed", "A vertex of the OFF file has fewer than three coordinates.")
    return np.array([list(map(float, row[:width])) for row in words], np.float64)


def _faces(rows: list[bytes], limits: LoadLimits) -> tuple[Any, U1 | None]:
    """(faces (f, 3) i8, their colours (f, 4) u1 or None)."""
    corners, owner = array("q"), array("q")
    colors: dict[int, list[float]] = {}
    for number, row in enumerate(rows):
        words = row.split()
        count = int(words[0])
        polygon, rest = list(map(int, words[1 : count + 1])), words[count + 1 :]
        for second, third in pairwise(polygon[1:]):
            corners.extend((polygon[0], second, third))
            owner.append(number)
        if len(rest) in (3, 4):
            colors[number] = [*map(float, rest)]
        if len(owner) > limits.max_faces:
            break  # the caller counts, and refuses
    faces = np.frombuffer(corners, np.int64).reshape(-1, 3)
    if not colors:
        return faces, None
    table = np.full((len(rows), 4), np.nan)
    for number, color in colors.items():
        table[number, : len(color)] = color
    given = np.isfinite(table[:, :3]).all(axis=1)
    shades = np.tile(np.array(NO_COLOR, np.uint8), (len(rows), 1))
    shades[given] = _bytes_of(table[given])
    return faces, shades[np.frombuffer(owner, np.int64)]


def _bytes_of(colors: F8) -> U1:
    """(n, 4) u1 of (n, 3 or 4) colours; an alpha that is missing is full."""
    full = 255.0 if np.nanmax(colors, initial=0.0) > 1.0 else 1.0
    unit = np.ones((len(colors), 4))
    unit[:, : colors.shape[1]] = np.nan_to_num(np.clip(colors / full, 0.0, 1.0), nan=1.0)
    return np.rint(unit * 255.0).astype(np.uint8)
