"""The stable codes of a refused upload, and the errors that carry them."""

from __future__ import annotations

from typing import Any

from schemas.errors import MeshRejectedError, SilhouetteError, TooLargeError, UnknownFormatError

CODES = frozenset(
    {
        "empty-file",
        "not-a-mesh",
        "format-mismatch",
        "truncated",
        "no-faces",
        "no-extent",
        "non-finite-vertices",
        "index-out-of-range",
        "decompression-limit",
        "external-reference",
        "forbidden-xml",
        "unsupported-feature",
        "parse-failed",
        "parser-crashed",
        "out-of-memory",
        "time-limit",
    }
)
"""Codes of MeshRejectedError."""

_ERRORS: dict[str, type[SilhouetteError]] = {"unknown-format": UnknownFormatError, "too-large": TooLargeError}


def rejected(code: str, message: str, **where: Any) -> MeshRejectedError:
    """The error to raise for bytes that are no usable mesh; `code` is one of CODES."""
    assert code in CODES, code
    return MeshRejectedError(message, code=code, **where)


def parse_failed(kind: str) -> MeshRejectedError:
    """The bytes passed the header checks and are wrong further in."""
    return rejected("parse-failed", f"The file starts like {kind}, but its contents could not be read.", format=kind)


def from_report(code: str, message: str, where: dict[str, Any]) -> SilhouetteError:
    """The error a child reported. The child read hostile bytes, so its words are taken only when they look like ours."""
    plain = isinstance(message, str) and 0 < len(message) <= 400 and message.isprintable()
    places: dict[str, Any] = {str(k)[:32]: v for k, v in where.items() if k not in ("code", "message") and _is_place(v)}
    if not plain or not (code in CODES or code in _ERRORS):
        return parse_failed("a mesh")
    return _ERRORS[code](message, **places) if code in _ERRORS else rejected(code, message, **places)


def _is_place(value: Any) -> bool:
    return isinstance(value, int | float) or (isinstance(value, str) and len(value) <= 64)
