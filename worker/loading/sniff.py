"""Own look at the bytes before any library: what they are, and whether they can be what they claim.

The name decides the format, and the bytes must agree. Bytes that are clearly another known format are refused with both
named rather than accepted quietly: the extension is part of a mesh's identity, and a wrong one is a mistake worth telling.
"""

from __future__ import annotations

from collections.abc import Callable

from schemas.errors import UnknownFormatError
from worker.loading.faults import rejected
from worker.loading.headers import glb, obj, off, ply, stl, threemf
from worker.loading.limits import LoadLimits

_CHECKS: dict[str, Callable[[bytes, LoadLimits], None]] = {
    "stl": stl.check,
    "obj": obj.check,
    "ply": ply.check,
    "off": off.check,
    "glb": glb.check,
    "3mf": threemf.check,
}
_SIGNS: dict[str, Callable[[bytes], bool]] = {
    "glb": glb.looks_like,
    "3mf": threemf.looks_like,
    "ply": ply.looks_like,
    "off": off.looks_like,
    "stl": stl.looks_like,
    "obj": obj.looks_like,
}
FORMATS = tuple(_CHECKS)
_MARKUP = (b"<!doctype html", b"<html", b"<?xml", b"<svg", b"%pdf-", b"\x89png", b"gif8", b"\xff\xd8\xff")


def normal_extension(extension: str) -> str:
    """The format named by an extension; UnknownFormatError when none has this name."""
    name = extension.strip().lstrip(".").lower()
    if name in ("gltf", "zip"):
        raise UnknownFormatError("Meshes of several files are not accepted; pack the model into one GLB file.", formats=", ".join(FORMATS))
    if name not in _CHECKS:
        raise UnknownFormatError(f"Only {', '.join(f.upper() for f in FORMATS)} files are read.", formats=", ".join(FORMATS))
    return name


def check(extension: str, data: bytes, limits: LoadLimits) -> None:
    """Refuse bytes that cannot be a whole mesh of the named format; MeshRejectedError says what is wrong and where."""
    kind = normal_extension(extension)
    if not data:
        raise rejected("empty-file", "The file is empty.")
    if not data.strip():
        raise rejected("not-a-mesh", "The file has nothing but blanks in it.")
    if not _SIGNS[kind](data):
        _refuse_other(kind, data)
    _CHECKS[kind](data, limits)


def _refuse_other(kind: str, data: bytes) -> None:
    head = data[:64].lstrip(b"\xef\xbb\xbf \t\r\n").lower()
    if head.startswith(_MARKUP):
        raise rejected("not-a-mesh", f"The file is named {kind.upper()}, but is a document or picture.")
    for other, sign in _SIGNS.items():
        if other != kind and sign(data):
            raise rejected(
                "format-mismatch", f"The file is named {kind.upper()}, but its bytes are {other.upper()}.", named=kind, found=other
            )
