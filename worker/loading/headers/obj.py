"""OBJ: lines of "v x y z" and "f i j k"; no magic, so the lines themselves are the sign."""

from __future__ import annotations

import re

from worker.loading.faults import rejected
from worker.loading.limits import LoadLimits

_VERTEX = re.compile(rb"^[ \t]*v[ \t]+[-+.\dni]", re.MULTILINE | re.IGNORECASE)
_FACE = re.compile(rb"^[ \t]*f[ \t]+[-\d]", re.MULTILINE)
_ZERO = re.compile(rb"^[ \t]*f[ \t](?:[^\n]*[ \t])?0+(?=[/\s]|\Z)", re.MULTILINE)
_POOR = re.compile(rb"^[ \t]*f(?:[ \t]+[-\d/]+){1,2}[ \t]*\r?$", re.MULTILINE)
SAMPLE = 1 << 16


def looks_like(data: bytes) -> bool:
    """Whether these are OBJ bytes: text with a vertex line near the start."""
    head = data[:SAMPLE]
    return b"\0" not in head and _VERTEX.search(head) is not None


def check(data: bytes, limits: LoadLimits) -> None:
    """Refuse a file without vertices or faces, faces of fewer than three corners and the index zero."""
    if b"\0" in data[:SAMPLE] or _VERTEX.search(data) is None:
        raise rejected("not-a-mesh", "The file is named OBJ, but has no vertex lines.")
    if _FACE.search(data) is None:
        raise rejected("no-faces", "The OBJ file has vertices and no faces.")
    zero = _ZERO.search(data)
    if zero:
        line = data.count(b"\n", 0, zero.start()) + 1
        raise rejected("index-out-of-range", f"Line {line} of the OBJ file uses the index 0; indices start at 1.", line=line)
    poor = _POOR.search(data)
    if poor:
        line = data.count(b"\n", 0, poor.start()) + 1
        raise rejected("parse-failed", f"Line {line} of the OBJ file is a face of fewer than three corners.", line=line)
