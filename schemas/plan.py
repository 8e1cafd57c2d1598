"""A plan, as the API tells it: what a request would do, why, and what it is predicted to cost."""

from __future__ import annotations

from typing import Literal

from pydantic import BaseModel, Field

from schemas.ladder import RungKey


class PlannedPass(BaseModel):
    """A pass of a plan. predicted_ms: none where nothing is known of its cost."""

    name: str
    why: str
    predicted_ms: float | None = None


class PlannedArea(BaseModel):
    """The rectangle of the image that can have anything of the mesh in it, pixels, row 0 at the top."""

    x: int
    y: int
    width: int
    height: int


class PlanReport(BaseModel):
    """What a request would do; nothing was drawn."""

    rung: str = Field(description="source/antialias, and /smooth", examples=["clipped/coverage"])
    chosen: RungKey = Field(description="the rung, whole")
    why: str = Field(description="why this rung")
    considered: int = Field(description="rungs that the mesh has")
    level_faces: int | None = Field(None, description="faces of the level that the outline is taken from; none for the mesh itself")
    error_px: float | None = Field(None, description="pixels by which the outline may be off the mesh's; none for a smooth one")
    bound: Literal["certified", "measured", "nominal"] = Field(
        description="certified: error_px holds whatever the mesh and the driver; measured: it was the largest found for this mesh; "
        "nominal: that of an ideal driver"
    )
    missed: list[str] = Field([], description="fields of `accuracy` that cannot be kept")
    device: str = Field(description="renderer that the costs are of")
    predicted_ms: float = Field(description="of the frame, from the resolved request to pixels in memory")
    passes: list[PlannedPass] = Field(description="what would run, in order")
    left_out: list[PlannedPass] = Field([], description="passes that other pictures have, and why this one has not")
    area: PlannedArea
