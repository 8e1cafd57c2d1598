"""Requests for sequences of pictures (names are final)."""

from __future__ import annotations

from enum import StrEnum
from typing import Any, Self

from pydantic import BaseModel, ConfigDict, Field, FiniteFloat, model_validator
from pydantic_core import PydanticCustomError

from schemas.render import AnyCamera, OrbitCamera, PictureRequest, RenderRequest

MOST_FRAMES = 1000
MOST_PIXELS = 1 << 26
"""Of all frames together: 256 of 512 x 512."""
USUAL_FRAMES = 36
"""Of a turn that does not say."""


EXAMPLE: dict[str, Any] = {
    "camera": {"orbit": {"azimuth_deg": 30, "elevation_deg": 20}},
    "turn": {"frames": 36},
    "width": 256,
    "height": 256,
    "fps": 18,
    "format": "webp",
}


class SequenceFormat(StrEnum):
    """Encodings: an animated WebP, an animated PNG, or PNGs numbered from 0000.png in an archive."""

    WEBP = "webp"
    APNG = "apng"
    ZIP = "zip"


class Turn(BaseModel):
    """A turntable: the orbit camera of the request goes round in even steps, and has come round with what would be the next frame."""

    model_config = ConfigDict(extra="forbid")

    frames: int | None = Field(None, ge=1, le=MOST_FRAMES, description=f"how many; as many as `positions`, or {USUAL_FRAMES}")
    degrees: FiniteFloat = Field(360.0, ge=-36000.0, le=36000.0, description="about +y, below 0 the other way round")


class SequenceRequest(PictureRequest):
    """Pictures of one mesh one after the other: seen from other places, with its vertices at other positions, or both."""

    model_config = ConfigDict(extra="forbid", json_schema_extra={"example": EXAMPLE})

    turn: Turn | None = Field(None, description="frames go round the mesh")
    cameras: list[AnyCamera] | None = Field(None, min_length=1, max_length=MOST_FRAMES, description="of each frame, instead of `camera`")
    fps: FiniteFloat = Field(25.0, ge=0.1, le=100.0, description="frames a second, of animations")
    loop: int = Field(0, ge=0, le=65535, description="times that an animation is played, 0 for ever")
    format: SequenceFormat | None = Field(None, description="overrides the Accept header")

    @model_validator(mode="after")
    def _one_way(self) -> Self:
        if self.turn is not None and self.cameras is not None:
            raise _wrong("cameras", "frames go round, or have cameras of their own: not both")
        if self.turn is not None and not isinstance(self.camera, OrbitCamera):
            raise _wrong("turn", "an orbit camera goes round: give camera.orbit instead of an eye")
        return self

    def camera_of(self, number: int, count: int) -> AnyCamera:
        """The camera of a frame of so many."""
        if self.cameras is not None:
            return self.cameras[number]
        if self.turn is None or not isinstance(self.camera, OrbitCamera):
            return self.camera
        orbit = self.camera.orbit
        return OrbitCamera(orbit=orbit.model_copy(update={"azimuth_deg": orbit.azimuth_deg + self.turn.degrees * number / count}))

    def picture(self, number: int, count: int) -> RenderRequest:
        """One of so many frames as a picture by itself."""
        fields = {name: getattr(self, name) for name in PictureRequest.model_fields}
        return RenderRequest.model_construct(**fields | {"camera": self.camera_of(number, count)})


def _wrong(field: str, message: str) -> PydanticCustomError:
    """A fault between fields, charged to the one field (in the error's `ctx`) that a caller would change."""
    return PydanticCustomError("unusable_sequence", message, {"field": field})
