"""Keys of the object store. Everything durable about a mesh lies under `meshes/<id>/`."""

from __future__ import annotations

import hashlib
import json
import re

from schemas.mesh import PreprocessOptions

PIPELINE_VERSION = 3
"""Part of every mesh id: raise it when artifacts of old and new code must not mix."""

MESH_ID = re.compile(r"^[0-9a-f]{32}$")
SHA256 = re.compile(r"^[0-9a-f]{64}$")
UPLOADS = "uploads/"
MESHES = "meshes/"
ACCEPTED = "accepted.json"
MANIFEST = "manifest.json"
"""Names of a mesh's records under its folder."""
API_KEYS = "keys/"
UNFINISHED = "unfinished/"
USES = "uses/"
UNKNOWN_UPLOAD = "unknown"
"""In the place of an upload's sha256: of a mesh whose acceptance cannot be read."""
USES_COMPLETE = "indexed/uses"
"""There when every accepted mesh has a use: in a store of an earlier version none has, until all of it has been gone through."""


def mesh_id(upload_sha256: str, extension: str, options: PreprocessOptions) -> str:
    """32 hex digits naming (bytes, format, options, pipeline version): the same upload twice is the same mesh."""
    identity = json.dumps([upload_sha256, extension, options.model_dump(mode="json", exclude_none=True), PIPELINE_VERSION], sort_keys=True)
    return hashlib.sha256(identity.encode()).hexdigest()[:32]


def upload(upload_sha256: str) -> str:
    """The uploaded bytes."""
    return f"{UPLOADS}{upload_sha256}"


def folder(mesh: str) -> str:
    """The prefix of everything of a mesh."""
    return f"{MESHES}{mesh}/"


def stage_name(stage: str) -> str:
    """Name of a stage's record under the mesh's folder."""
    return f"stages/{stage}.json"


def accepted(mesh: str) -> str:
    """The acceptance record (`schemas.manifest.Accepted`), written before 202."""
    return f"{folder(mesh)}{ACCEPTED}"


def stage_record(mesh: str, stage: str) -> str:
    """The record of a finished stage (`schemas.manifest.StageRecord`), written after its artifacts."""
    return f"{folder(mesh)}{stage_name(stage)}"


def partial(mesh: str, stage: str) -> str:
    """What an interrupted stage had done so far; gone when its record is written."""
    return f"{folder(mesh)}stages/{stage}.partial"


def artifact(mesh: str, name: str) -> str:
    """An artifact file; names are in `schemas.artifacts`."""
    return f"{folder(mesh)}{name}"


def manifest(mesh: str) -> str:
    """The manifest (`schemas.manifest.Manifest`), written last: ready or failed for good."""
    return f"{folder(mesh)}{MANIFEST}"


def unfinished(mesh: str) -> str:
    """The mark of a mesh that something is to be done for (`backend.unfinished`)."""
    return f"{UNFINISHED}{mesh}"


def uses(upload_sha256: str) -> str:
    """The prefix of the uses of an upload; the names under it are ids of meshes."""
    return f"{USES}{upload_sha256}/"


def use(upload_sha256: str, mesh: str) -> str:
    """Says that a mesh is made of an upload; written before its acceptance."""
    return f"{uses(upload_sha256)}{mesh}"


def api_key(key_id: str) -> str:
    """The record of an API key (`schemas.access.KeyRecord`)."""
    return f"{API_KEYS}{key_id}.json"
