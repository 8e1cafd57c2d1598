"""OFF: "OFF", three counts, a line a vertex, a line a face."""

from __future__ import annotations

import re

from worker.loading.faults import rejected
from worker.loading.limits import LoadLimits

_HEAD = re.compile(rb"^\s*(?:#[^\n]*\n\s*)*((?:ST)?C?N?(?:4|4n|n)?OFF)(\s+BINARY)?\b", re.IGNORECASE)


def looks_like(data: bytes) -> bool:
    """Whether these are OFF bytes."""
    return _HEAD.match(data[:4096]) is not None


def statements(data: bytes) -> tuple[bytes, list[bytes]]:
    """(the first word in capitals, all that follow it without comments and empty lines: counts, vertices, faces).

    Raises MeshRejectedError when it is no OFF.
    """
    head = _HEAD.match(data[:4096])
    if head is None:
        raise rejected("not-a-mesh", "The file is named OFF, but does not start with OFF.")
    lines = [s for line in data[head.end() :].splitlines() if (s := line.split(b"#", 1)[0].strip())]
    return head[1].upper(), lines


def check(data: bytes, limits: LoadLimits) -> None:
    """Refuse variants that are not three-dimensional text, and counts the file has no lines for."""
    head = _HEAD.match(data[:4096])
    if head is None:
        raise rejected("not-a-mesh", "The file is named OFF, but does not start with OFF.")
    kind = head[1].upper()
    if head[2] or b"4" in kind or b"nOFF" in head[1] or b"ST" in kind:
        raise rejected("unsupported-feature", "Only text OFF files with three coordinates a vertex are read.")
    _, lines = statements(data)
    counts = lines[0].split() if lines else []
    if len(counts) < 2 or not all(c.isdigit() and len(c) < 19 for c in counts[:2]):
        raise rejected("not-a-mesh", "The OFF file does not give its counts of vertices and faces.")
    vertices, faces = int(counts[0]), int(counts[1])
    if not faces or not vertices:
        raise rejected("no-faces", f"The OFF file has {vertices} vertices and {faces} faces.", vertices=vertices)
    if vertices + faces > len(lines) - 1:
        raise rejected(
            "truncated",
            f"The OFF file declares {vertices} vertices and {faces} faces, but has {len(lines) - 1} lines for them.",
            expected_rows=vertices + faces,
            rows=len(lines) - 1,
        )
    for offset, line in enumerate(lines[vertices + 1 : vertices + faces + 1]):
        words = line.split()
        if not words[0].isdigit() or int(words[0][:9]) >= len(words):
            raise rejected("parse-failed", f"Face {offset} of the OFF file has fewer indices than it declares.", face=offset)
