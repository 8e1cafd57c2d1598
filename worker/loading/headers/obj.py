"""OBJ: lines of "v x y z" and "f i j k"; no magic, so the lines themselves are the sign."""

from __future__ import annotations

import re

from worker.loading.faults import rejected
from worker.loading.limits import LoadLimits

_VERTEX = re.compile(rb"^[ \t]*v[ \t]+[-+.\dni]", re.MULTILINE | re.IGNORECASE)
SAMPLE = 1 << 16


def looks_like(data: bytes) -> bool:
    """Whether these are OBJ bytes: text with a vertex line near the start."""
    head = data[:SAMPLE].replace(b"\r", b"\n")
    return b"\0" not in head and _VERTEX.search(head) is not None


def check(data: bytes, limits: LoadLimits) -> None:
    """Refuse what is no text with vertex lines; the lines are checked as they are read."""
    if b"\0" in data[:SAMPLE] or _VERTEX.search(data.replace(b"\r", b"\n")) is None:
        raise rejected("not-a-mesh", "The file is named OBJ, but has no vertex lines.")
