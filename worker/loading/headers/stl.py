"""STL: 84 + 50 n bytes, or text from "solid" to "endsolid"."""

from __future__ import annotations

import re

import numpy as np

from worker.loading.faults import rejected
from worker.loading.limits import LoadLimits

HEADER = 84
RECORD = np.dtype([("normal", "<f4", 3), ("vertices", "<f4", (3, 3)), ("attribute", "<u2")])

_FACET = re.compile(rb"\bfacet\s+normal\b")
_SPOILT = re.compile(rb"vertex[^\n]*\b(?:nan|inf|infinity)\b")


def looks_like(data: bytes) -> bool:
    """Whether these are STL bytes of either kind."""
    return _is_binary(data) or data[:512].lstrip()[:5].lower() == b"solid"


def _is_binary(data: bytes) -> bool:
    return len(data) >= HEADER and len(data) == HEADER + RECORD.itemsize * _declared(data)


def _declared(data: bytes) -> int:
    return int.from_bytes(data[80:84], "little")


def check(data: bytes, limits: LoadLimits) -> None:
    """Refuse a truncated file, one without faces, and coordinates that are no numbers."""
    if _is_binary(data):
        _check_binary(data)
    elif data[:512].lstrip()[:5].lower() == b"solid" and b"\0" not in data[:HEADER]:
        _check_text(data)
    elif len(data) < HEADER or _printable(data[:HEADER]):
        raise rejected("not-a-mesh", "The file is named STL, but it is neither binary nor text STL.")
    else:
        _refuse_size(data)


def _printable(head: bytes) -> bool:
    return all(32 <= c < 127 or c in b"\t\r\n" for c in head)


def _refuse_size(data: bytes) -> None:
    expected = HEADER + RECORD.itemsize * _declared(data)
    if len(data) < expected:
        raise rejected(
            "truncated",
            f"The STL file declares {_declared(data)} faces, which take {expected} bytes, but it has {len(data)}.",
            expected_bytes=expected,
            bytes=len(data),
        )
    raise rejected(
        "not-a-mesh", f"The STL file declares {_declared(data)} faces, but has {len(data) - expected} bytes more than they take."
    )


def _check_binary(data: bytes) -> None:
    if not _declared(data):
        raise rejected("no-faces", "The STL file has no faces.")
    vertices = np.frombuffer(data, RECORD, offset=HEADER)["vertices"]
    bad = np.flatnonzero(~np.isfinite(vertices).all(axis=(1, 2)))
    if len(bad):
        raise rejected("non-finite-vertices", f"Face {bad[0]} of the STL file has a coordinate that is not finite.", face=int(bad[0]))


def _check_text(data: bytes) -> None:
    text = data.lower()
    if len(data) > HEADER and b"facet" not in text and b"endsolid" not in text:
        _refuse_size(data)
    facets, ended = len(_FACET.findall(text)), text.count(b"endfacet")
    if text.rfind(b"endsolid") < text.rfind(b"vertex") or b"endsolid" not in text or facets != ended:
        raise rejected(
            "truncated",
            f"The text STL file breaks off: {facets} faces begin and {ended} end, then it is not closed by endsolid.",
            faces=facets,
        )
    if not facets:
        raise rejected("no-faces", "The STL file has no faces.")
    spoilt = _SPOILT.search(text)
    if spoilt:
        line = text.count(b"\n", 0, spoilt.start()) + 1
        raise rejected("non-finite-vertices", f"Line {line} of the STL file has a coordinate that is not finite.", line=line)
    vertices = len(re.findall(rb"^\s*vertex\s", text, re.MULTILINE))
    if vertices != 3 * facets:
        raise rejected(
            "parse-failed", f"The text STL file has {facets} faces but {vertices} vertices; three a face are needed.", faces=facets
        )
