"""GLB (binary glTF 2.0): a length, a JSON chunk, a binary chunk; every view and accessor must lie within its buffer."""

from __future__ import annotations

import json
from typing import Any

from schemas.errors import MeshRejectedError
from worker.loading.faults import rejected
from worker.loading.limits import MIB, LoadLimits

JSON_CHUNK, BINARY_CHUNK = 0x4E4F534A, 0x004E4942
MAX_JSON = 64 * MIB
COMPONENT_BYTES = {5120: 1, 5121: 1, 5122: 2, 5123: 2, 5125: 4, 5126: 4}
COMPONENTS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT2": 4, "MAT3": 9, "MAT4": 16}
HARMLESS_EXTENSIONS = ("KHR_materials_", "KHR_lights_punctual", "EXT_texture_webp")
"""Extensions a file may require that change the shading and not the shape."""


def looks_like(data: bytes) -> bool:
    """Whether these are GLB bytes."""
    return data[:4] == b"glTF"


def check(data: bytes, limits: LoadLimits) -> None:
    """Refuse wrong lengths, views and accessors beyond their buffer, and what the file does not contain itself."""
    if not looks_like(data):
        raise rejected("not-a-mesh", "The file is named GLB, but does not start like one.")
    tree, binary = _chunks(data)
    try:
        buffers = [_buffer_bytes(i, b, binary) for i, b in enumerate(_list(tree, "buffers"))]
        _check_extensions(tree)
        views = [_view_bytes(i, v, buffers) for i, v in enumerate(_list(tree, "bufferViews"))]
        for i, accessor in enumerate(_list(tree, "accessors")):
            _check_accessor(i, accessor, views)
        if not all(isinstance(image, dict) for image in _list(tree, "images")):
            raise _not_gltf()
        primitives = [p for m in _list(tree, "meshes") for p in m["primitives"]]
    except (KeyError, TypeError, ValueError, AttributeError, IndexError):
        raise _not_gltf() from None
    if not primitives:
        raise rejected("no-faces", "The GLB file has no mesh.")


def _not_gltf() -> MeshRejectedError:
    return rejected("parse-failed", "The JSON chunk of the GLB file is not laid out as glTF.")


def external_images(data: bytes) -> int:
    """How many images of a checked file lie outside it."""
    tree, _ = _chunks(data)
    return sum("uri" in image and not str(image["uri"]).startswith("data:") for image in _list(tree, "images"))


def _chunks(data: bytes) -> tuple[dict[str, Any], int]:
    """The JSON chunk, and the bytes of the binary chunk."""
    if len(data) < 20:
        raise rejected("truncated", f"The GLB file has {len(data)} bytes, fewer than its header takes.", bytes=len(data))
    version, length, size, kind = (int.from_bytes(data[i : i + 4], "little") for i in (4, 8, 12, 16))
    if version != 2:
        raise rejected("unsupported-feature", f"The GLB file is of version {version}; only version 2 is read.")
    if length > len(data):
        raise rejected(
            "truncated", f"The GLB file says it has {length} bytes, but there are {len(data)}.", expected_bytes=length, bytes=len(data)
        )
    if kind != JSON_CHUNK or 20 + size > length or size > MAX_JSON:
        raise rejected("not-a-mesh", "The GLB file does not begin with a JSON chunk that fits into it.")
    try:
        tree = json.loads(data[20 : 20 + size])
    except (ValueError, RecursionError):
        tree = None
    if not isinstance(tree, dict):
        raise rejected("parse-failed", "The JSON chunk of the GLB file is not a JSON object.")
    return tree, _binary_bytes(data, 20 + size, length)


def _binary_bytes(data: bytes, at: int, length: int) -> int:
    if at + 8 > length:
        return 0
    size, kind = int.from_bytes(data[at : at + 4], "little"), int.from_bytes(data[at + 4 : at + 8], "little")
    if at + 8 + size > length:
        raise rejected(
            "truncated", f"The binary chunk of the GLB file says it has {size} bytes, but {length - at - 8} are left.", bytes=size
        )
    return size if kind == BINARY_CHUNK else 0


def _list(tree: dict[str, Any], name: str) -> list[Any]:
    value = tree.get(name, [])
    if not isinstance(value, list):
        raise TypeError(name)
    return value


def _natural(value: Any) -> int:
    if not isinstance(value, int) or isinstance(value, bool) or value < 0:
        raise TypeError(value)
    return value


def _buffer_bytes(index: int, buffer: dict[str, Any], binary: int) -> int:
    uri = buffer.get("uri")
    if uri is not None:
        if not str(uri).startswith("data:"):
            raise rejected(
                "external-reference", f"Buffer {index} of the GLB file lies in another file; pack it into one GLB.", buffer=index
            )
        return len(str(uri).partition("base64,")[2]) * 3 // 4
    if _natural(buffer["byteLength"]) > binary:
        raise rejected(
            "truncated", f"Buffer {index} of the GLB file takes {buffer['byteLength']} bytes, but there are {binary}.", buffer=index
        )
    return binary


def _check_extensions(tree: dict[str, Any]) -> None:
    for name in _list(tree, "extensionsRequired"):
        if not str(name).startswith(HARMLESS_EXTENSIONS):
            shown = str(name) if str(name).isascii() and str(name).isidentifier() and len(name) < 64 else "unknown"
            raise rejected("unsupported-feature", f"The GLB file requires the extension {shown}, which is not supported.")


def _view_bytes(index: int, view: dict[str, Any], buffers: list[int]) -> tuple[int, int]:
    size, stride = _natural(view["byteLength"]), _natural(view.get("byteStride", 0))
    if _natural(view.get("byteOffset", 0)) + size > buffers[_natural(view["buffer"])]:
        raise rejected("truncated", f"Buffer view {index} of the GLB file reaches beyond its buffer.", view=index)
    return size, stride


def _check_accessor(index: int, accessor: dict[str, Any], views: list[tuple[int, int]]) -> None:
    count, item = _natural(accessor["count"]), COMPONENT_BYTES[accessor["componentType"]] * COMPONENTS[accessor["type"]]
    if "sparse" in accessor:
        raise rejected("unsupported-feature", f"Accessor {index} of the GLB file is sparse, which is not supported.", accessor=index)
    if "bufferView" not in accessor:
        raise rejected("truncated", f"Accessor {index} of the GLB file declares {count} items but names no bytes for them.", accessor=index)
    size, stride = views[_natural(accessor["bufferView"])]
    last = _natural(accessor.get("byteOffset", 0)) + (max(count - 1, 0) * (stride or item) + item if count else 0)
    if last > size:
        raise rejected("truncated", f"Accessor {index} of the GLB file reaches beyond its buffer view.", accessor=index)
