"""The records that make the store the truth: what was accepted, what each stage did, and how it ended."""

from __future__ import annotations

from datetime import datetime
from typing import Any, Literal

from pydantic import BaseModel

from schemas.mesh import Capability, HullInfo, MeshStats, PreprocessOptions, Problem


class Accepted(BaseModel):
    """An accepted upload; durable before the client gets its 202."""

    id: str
    name: str
    extension: str
    upload_sha256: str
    upload_bytes: int
    options: PreprocessOptions
    created: datetime


class FrameRecord(BaseModel):
    """`conventions.Frame` as JSON."""

    centre: tuple[float, float, float]
    scale: float


class StageRecord(BaseModel):
    """A finished stage: its artifacts by name with their sha256, and its report (plain JSON, see each stage's docstring)."""

    stage: str
    outcome: Literal["done", "skipped", "failed"]
    seconds: float
    peak_mib: float | None = None
    artifacts: dict[str, str] = {}
    report: dict[str, Any] = {}
    error: Problem | None = None


class Manifest(BaseModel):
    """How the preprocessing of a mesh ended. Written once, last.

    What is known of a mesh before that has the same form, with the status loaded and without an end; that is never written. Nor are
    records of later stages in `stages`, which are added when a ready mesh is read.
    """

    id: str
    status: Literal["loaded", "ready", "failed"]
    frame: FrameRecord | None = None
    stats: MeshStats | None = None
    capabilities: dict[str, Capability] = {}
    hull: HullInfo | None = None
    repairs: dict[str, Any] | None = None
    stages: list[StageRecord] = []
    error: Problem | None = None
    finished: datetime | None = None
