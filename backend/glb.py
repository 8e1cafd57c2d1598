"""Binary glTF 2.0 files, as workers keep them and the service makes them when asked."""

from __future__ import annotations

import json
import struct
from collections.abc import Mapping
from typing import Any

import numpy as np

from schemas.conventions import F4, I4, Array, Frame

UNSIGNED_INT, FLOAT, ARRAY_BUFFER, ELEMENT_ARRAY_BUFFER = 5125, 5126, 34962, 34963  # glTF's (OpenGL's) numbers


def placed(name: str, frame: Frame) -> dict[str, Any]:
    """A node for mesh 0: the mesh stays in the normalised frame, so that no precision is lost far from the origin."""
    return {"name": name, "mesh": 0, "translation": list(frame.centre), "scale": [frame.scale] * 3}


def bare_glb(name: str, positions: F4, faces: I4, frame: Frame, more: Mapping[str, Array] | None = None) -> bytes:
    """A mesh without maps, positions (v, 3) f4 normalised and faces (f, 3) i4, in model units; viewers shade its faces flat.

    more: further attributes (v,) or (v, 2..4) of its vertices, by name.
    """
    file = Glb()
    columns = {"POSITION": positions, **(more or {})}
    attributes = {key: file.add_accessor(np.ascontiguousarray(values, "<f4")) for key, values in columns.items()}
    primitive = {"attributes": attributes, "indices": file.add_triangles(faces), "mode": 4}
    return file.to_bytes(scene=0, scenes=[{"nodes": [0]}], nodes=[placed(name, frame)], meshes=[{"name": name, "primitives": [primitive]}])


class Glb:
    """A binary glTF file as it grows: one buffer, its views, accessors and images."""

    def __init__(self) -> None:
        self._buffer = bytearray()
        self._views: list[dict[str, Any]] = []
        self._accessors: list[dict[str, Any]] = []
        self._images: list[dict[str, Any]] = []

    def _add_view(self, data: bytes, **more: Any) -> int:
        self._buffer.extend(b"\0" * (-len(self._buffer) % 4))
        self._views.append({"buffer": 0, "byteOffset": len(self._buffer), "byteLength": len(data), **more})
        self._buffer.extend(data)
        return len(self._views) - 1

    def add_triangles(self, faces: I4) -> int:
        """Index of an accessor of the corners of triangles (n, 3) i4."""
        data = np.ascontiguousarray(faces, "<u4").tobytes()
        view = self._add_view(data, target=ELEMENT_ARRAY_BUFFER)
        self._accessors.append({"bufferView": view, "componentType": UNSIGNED_INT, "count": faces.size, "type": "SCALAR"})
        return len(self._accessors) - 1

    def add_accessor(self, values: Array) -> int:
        """Index of an accessor of (n,) or (n, 2..4) f4 vertex values."""
        low, high = np.atleast_1d(values.min(axis=0)), np.atleast_1d(values.max(axis=0))
        self._accessors.append(
            {
                "bufferView": self._add_view(values.tobytes(), target=ARRAY_BUFFER),
                "componentType": FLOAT,
                "count": len(values),
                "type": "SCALAR" if values.ndim == 1 else f"VEC{values.shape[1]}",
                "min": [float(x) for x in low],
                "max": [float(x) for x in high],
            }
        )
        return len(self._accessors) - 1

    def add_texture(self, name: str, png: bytes) -> int:
        """Index of a texture (and image) with sampler 0."""
        self._images.append({"name": name, "mimeType": "image/png", "bufferView": self._add_view(png)})
        return len(self._images) - 1

    def to_bytes(self, **parts: Any) -> bytes:
        """The file, with further top-level parts of the JSON."""
        document = {"asset": {"version": "2.0", "generator": "silhouette-service"}, **parts}
        if self._images:
            document |= {"textures": [{"sampler": 0, "source": i} for i in range(len(self._images))], "images": self._images}
        document |= {
            "accessors": self._accessors,
            "bufferViews": self._views,
            "buffers": [{"byteLength": len(self._buffer)}],
        }
        text = json.dumps(document, separators=(",", ":")).encode()
        text += b" " * (-len(text) % 4)
        data = bytes(self._buffer) + b"\0" * (-len(self._buffer) % 4)
        total = 12 + 8 + len(text) + 8 + len(data)
        return b"".join(
            [
                struct.pack("<4sII", b"glTF", 2, total),
                struct.pack("<I4s", len(text), b"JSON"),
                text,
                struct.pack("<I4s", len(data), b"BIN\0"),
                data,
            ]
        )
