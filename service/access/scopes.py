"""Which scope a request needs: by method and address, in one table read from the top."""

from __future__ import annotations

import re

from schemas.access import Scope

OPEN = frozenset({"/healthz", "/readyz"})
"""Answered to everyone: whoever watches the process has no key."""

READING_METHODS = frozenset({"GET", "HEAD", "OPTIONS"})

RULES: tuple[tuple[re.Pattern[str], Scope], ...] = (
    (re.compile(r"/v1/keys(/.*)?"), Scope.ADMIN),
    (re.compile(r"/metrics"), Scope.ADMIN),
    (re.compile(r"/v1/meshes/[^/]+/(render|silhouette|frames)"), Scope.READ),
    (re.compile(r"/v1/(scenes/render|sign)"), Scope.READ),
)
"""Addresses whose scope does not follow from the method; the rest reads by GET and writes by any other."""

PICTURES = re.compile(
    r"/v1/(render|silhouette|scenes/render)"
    r"|/v1/meshes/[^/]+/((render|silhouette|thumbnail|turntable|accuracy)(\.[a-z]+)?|frames|artifacts/hull\.glb)"
)
"""Addresses that draw, extract or cut: what a limit on work at once is about."""


def scope_of(method: str, path: str) -> Scope:
    """The scope that a request of everything but `OPEN` needs."""
    for pattern, scope in RULES:
        if pattern.fullmatch(path):
            return scope
    return Scope.READ if method in READING_METHODS else Scope.WRITE


def is_picture(path: str) -> bool:
    """Whether the address makes something of a mesh."""
    return PICTURES.fullmatch(path) is not None
