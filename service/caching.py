"""Entity tags that need no rendering: an answer is a function of mesh, request and program, and a mesh id is a hash itself.

A picture is one of what there is of its mesh, too (`service.assets.state_of`).
"""

from __future__ import annotations

import hashlib
from importlib.metadata import version

from fastapi import Request, Response

from schemas import keys

IMMUTABLE = "public, max-age=31536000, immutable"
"""For answers that never change while the mesh exists."""

REVALIDATE = "no-cache"
"""Keep it, but ask each time: the question costs a hash, not a picture."""

NOT_KEPT = "no-store"
"""For answers that will soon be others."""

PROGRAM = f"{version('silhouette-service')}.{keys.PIPELINE_VERSION}"


def entity_tag(mesh_id: str, *parts: str) -> str:
    """Weak tag of the answer to a request: the same picture, though another graphics driver may set other last bits."""
    identity = "\0".join([PROGRAM, mesh_id, *parts])
    return f'W/"{hashlib.sha256(identity.encode()).hexdigest()[:32]}"'


def not_modified(request: Request, tag: str, cache_control: str) -> Response | None:
    """304 when the client has that answer already, by its If-None-Match (weak comparison, RFC 9110 section 13.1.2)."""
    known = request.headers.get("if-none-match")
    if known is None:
        return None
    tags = [item.strip().removeprefix("W/") for item in known.split(",")]
    if "*" not in tags and tag.removeprefix("W/") not in tags:
        return None
    return Response(status_code=304, headers={"ETag": tag, "Cache-Control": cache_control, "Vary": "Accept"})
