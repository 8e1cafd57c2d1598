"""What the API says about a mesh (names are final)."""

from __future__ import annotations

from datetime import datetime
from enum import StrEnum
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field

DEFAULT_HULL_FACES = 1000
DEFAULT_TEXELS = 1024


class MeshStatus(StrEnum):
    """Where a mesh stands."""

    QUEUED = "queued"
    PROCESSING = "processing"
    READY = "ready"
    FAILED = "failed"


class StageStatus(StrEnum):
    """Where a stage of a mesh stands; skipped: the mesh has no use for it."""

    QUEUED = "queued"
    RUNNING = "running"
    DONE = "done"
    SKIPPED = "skipped"
    FAILED = "failed"


class Problem(BaseModel):
    """RFC 9457 problem details; also how a failed mesh or stage says why."""

    model_config = ConfigDict(extra="allow")

    type: str = "about:blank"
    title: str
    status: int
    detail: str


class PreprocessOptions(BaseModel):
    """Options of an upload; together with the bytes they are the mesh's identity."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    hull_faces: int = Field(DEFAULT_HULL_FACES, ge=4, le=100_000, description="faces of the coarse hull that is drawn")
    texels: int = Field(DEFAULT_TEXELS, ge=64, le=8192, description="longest side of the normal and colour maps, texels")
    repair: Literal["auto", "never"] = Field("auto", description="close small holes and orient faces, or take the mesh as it is")
    max_faces: int | None = Field(None, ge=1, description="refuse a mesh of more faces; a key's limit may be lower")

    def narrowed(self, max_faces: int | None) -> PreprocessOptions:
        """The same with at most so many faces."""
        given = [limit for limit in (self.max_faces, max_faces) if limit is not None]
        return self.model_copy(update={"max_faces": min(given)}) if given else self


class Stage(BaseModel):
    """Progress of one preprocessing stage."""

    name: str
    status: StageStatus = StageStatus.QUEUED
    progress: float = Field(0.0, ge=0.0, le=1.0)
    seconds: float | None = None
    error: Problem | None = None


class MeshStats(BaseModel):
    """Measured facts of the mesh as stored, in model units."""

    vertices: int
    faces: int
    edges: int
    components: int
    closed: bool
    oriented: bool
    bounds: list[list[float]] = Field(description="[[min x, y, z], [max x, y, z]]")


class BoundingSphere(BaseModel):
    """Sphere around the mesh, in model units: what an orbit camera turns about and fits into the image."""

    centre: tuple[float, float, float]
    radius: float


class Capability(BaseModel):
    """Whether the mesh can do something, and why not."""

    available: bool
    reason: str | None = None


class HullLevel(BaseModel):
    """A hull of the stored sequences, measured: an outer one encloses the original, an inner one is enclosed by it."""

    side: Literal["outer", "inner"]
    faces: int
    volume_excess: float = Field(description="as of the drawn hull; negative for an inner hull")
    distance: float = Field(description="no point of it is further than this from the original, model units")


class HullInfo(BaseModel):
    """The coarse hull that is drawn."""

    faces: int
    volume_excess: float = Field(description="(volume of the hull - volume of the original) / volume of the original")
    levels: list[HullLevel] = Field([], description="hulls of other sizes, outer ones first, each kind from fine to coarse")


class MeshInfo(BaseModel):
    """Everything a client sees of a mesh."""

    id: str
    name: str
    status: MeshStatus
    stages: list[Stage] = []
    stats: MeshStats | None = None
    sphere: BoundingSphere | None = None
    capabilities: dict[str, Capability] = {}
    hull: HullInfo | None = None
    repairs: dict[str, Any] | None = Field(None, description="what loading changed: welded vertices, closed holes, flipped components, ...")
    error: Problem | None = None
    links: dict[str, str] = {}
    created: datetime


class MeshPage(BaseModel):
    """A page of meshes, newest first; `next` is the link of the following page."""

    meshes: list[MeshInfo]
    next: str | None = None
