"""Requests for pictures of several meshes (names are final)."""

from __future__ import annotations

from typing import Annotated, Any, Self, TypeVar

import numpy as np
from pydantic import BaseModel, ConfigDict, Discriminator, Field, FiniteFloat, Tag, model_validator
from pydantic_core import PydanticCustomError

from schemas.conventions import F8
from schemas.lines import Lines, LineStyle
from schemas.render import MAX_SIDE_PX, Accuracy, AnyCamera, ImageFormat, Orbit, OrbitCamera, Shading, Vector

MAX_OBJECTS = 64
"""Objects of one scene: each pair of them may have to be compared."""
MOST_STRETCH = 1e6
"""The longest axis of a placed sphere over its shortest: beyond, a transform counts as flattening."""

Fields = TypeVar("Fields", bound=BaseModel)
Quaternion = Annotated[list[FiniteFloat], Field(min_length=4, max_length=4)]
Row = Annotated[list[FiniteFloat], Field(min_length=4, max_length=4)]
Matrix = Annotated[list[Row], Field(min_length=4, max_length=4, description="4 rows of 4, for column vectors: [[.., .., .., tx], ...]")]

TRANSFORM_FORMS = (
    "transform by matrix",
    "transform by parts",
    "rotation by quaternion",
    "rotation by axis",
    "one scale",
    "scale by axis",
)
"""Names of the forms inside error locations; faults are reported for the form that was meant."""


def _form(listed: str, other: str) -> Discriminator:
    """Tells a list from what else a field may be."""
    return Discriminator(lambda value: listed if isinstance(value, (list, tuple)) else other)


class _Request(BaseModel):
    model_config = ConfigDict(extra="forbid")


def _wrong(message: str, field: str | None = None) -> PydanticCustomError:
    return PydanticCustomError("unusable_transform", message, {"field": field} if field else None)


class AxisAngle(_Request):
    """A rotation about an axis of any length, counter-clockwise seen from its tip."""

    axis: Vector
    angle_deg: FiniteFloat

    @model_validator(mode="after")
    def _has_axis(self) -> Self:
        if not any(self.axis):
            raise _wrong("the axis is the zero vector", "axis")
        return self


Rotation = Annotated[
    Annotated[Quaternion, Tag("rotation by quaternion")] | Annotated[AxisAngle, Tag("rotation by axis")],
    _form("rotation by quaternion", "rotation by axis"),
]
Scale = Annotated[Annotated[FiniteFloat, Tag("one scale")] | Annotated[Vector, Tag("scale by axis")], _form("scale by axis", "one scale")]


class Parts(_Request):
    """A transform by its parts: scaled along the mesh's axes, then rotated, then moved. Negative factors mirror."""

    translate: Vector = Field([0.0, 0.0, 0.0], description="scene units")
    rotate: Rotation = Field([0.0, 0.0, 0.0, 1.0], description="unit quaternion [x, y, z, w] (any length but zero), or {axis, angle_deg}")
    scale: Scale = Field(1.0, description="one factor, or one along each axis of the mesh; none of them zero")


Transform = Annotated[
    Annotated[Matrix, Tag("transform by matrix")] | Annotated[Parts, Tag("transform by parts")],
    _form("transform by matrix", "transform by parts"),
]


class SceneObject(_Request):
    """One mesh in a scene. Its shading and its lines have the scene's for every field they do not say."""

    mesh: str = Field(min_length=1, max_length=64, description="mesh id")
    transform: Transform = Field(default_factory=Parts, description="scene from model: affine and invertible; it may stretch and mirror")
    shading: Shading | None = None
    lines: Lines | None = Field(None, description="if not given, the scene's; null for none")

    @model_validator(mode="after")
    def _usable(self) -> Self:
        if fault := _fault(self.transform):
            raise _wrong(fault, "transform")
        return self


class SceneRequest(_Request):
    """One picture of several meshes. An orbit turns about the sphere around all of them, and fits it."""

    model_config = ConfigDict(
        extra="forbid",
        json_schema_extra={
            "example": {
                "camera": {"orbit": {"azimuth_deg": 30, "elevation_deg": 20}},
                "background": "#ffffff",
                "lines": {"silhouette": {"width": 2}},
                "objects": [
                    {"mesh": "0123456789abcdef0123456789abcdef"},
                    {
                        "mesh": "0123456789abcdef0123456789abcdef",
                        "transform": {"translate": [2, 0, 0], "rotate": {"axis": [0, 1, 0], "angle_deg": 90}, "scale": [1, 1, -1]},
                        "shading": {"color": "#c08040"},
                        "lines": {"silhouette": {"color": "#804000"}, "ridge": {}},
                    },
                ],
            }
        },
    )

    camera: AnyCamera = OrbitCamera(orbit=Orbit(azimuth_deg=30.0, elevation_deg=20.0))
    width: int = Field(512, ge=1, le=MAX_SIDE_PX)
    height: int = Field(512, ge=1, le=MAX_SIDE_PX)
    background: str = Field("transparent", pattern=r"^(transparent|#[0-9a-fA-F]{6})$")
    objects: list[SceneObject] = Field(min_length=1, max_length=MAX_OBJECTS)
    shading: Shading = Shading()
    lines: Lines | None = Field(None, description="lines of every object, all of which then are drawn together from their original meshes")
    accuracy: Accuracy = Accuracy()
    format: ImageFormat | None = Field(None, description="overrides the Accept header")

    def shading_of(self, index: int) -> Shading:
        """What object `index` is shaded with: its own fields where it says them, the scene's elsewhere."""
        own = self.objects[index].shading
        return self.shading if own is None else _over(own, self.shading)

    def lines_of(self, index: int) -> Lines | None:
        """The lines of object `index`: the scene's, with what the object's own say of them; none where those are null."""
        item = self.objects[index]
        if "lines" not in item.model_fields_set:
            return self.lines
        return item.lines if item.lines is None or self.lines is None else _over(item.lines, self.lines)

    def resolved(self) -> SceneRequest:
        """The same with all of its shading and lines said by every object, so that requests that are dumped alike are drawn alike."""
        looks = [{"shading": self.shading_of(index), "lines": self.lines_of(index)} for index in range(len(self.objects))]
        objects = [item.model_copy(update=look) for item, look in zip(self.objects, looks, strict=True)]
        return self.model_copy(update={"objects": objects})

    @property
    def has_lines(self) -> bool:
        """Whether some object has lines."""
        return any((item.lines if "lines" in item.model_fields_set else self.lines) is not None for item in self.objects)


def _over(own: Fields, other: Fields) -> Fields:
    """`own` where it says something, `other` elsewhere; the styles of lines field by field too."""
    said = {}
    for name in own.model_fields_set:
        value, beneath = getattr(own, name), getattr(other, name)
        said[name] = _over(value, beneath) if isinstance(value, LineStyle) and isinstance(beneath, LineStyle) else value
    return other.model_copy(update=said)


def matrix_of(transform: Any) -> F8:
    """(4, 4) f8: scene from model, for column vectors, of a transform in either form."""
    if not isinstance(transform, Parts):
        return np.array(transform, np.float64)
    matrix = np.eye(4)
    rotation = _from_axis(transform.rotate) if isinstance(transform.rotate, AxisAngle) else _from_quaternion(transform.rotate)
    matrix[:3, :3] = rotation * np.broadcast_to(np.array(transform.scale, np.float64), 3)
    matrix[:3, 3] = transform.translate
    return matrix


def _fault(transform: Any) -> str | None:
    """What is wrong with a transform, for people; None when it can be used."""
    if isinstance(transform, Parts) and not isinstance(transform.rotate, AxisAngle) and not any(transform.rotate):
        return "the quaternion is zero"
    matrix = matrix_of(transform)
    if not np.array_equal(matrix[3], [0.0, 0.0, 0.0, 1.0]):
        return "the last row must be 0, 0, 0, 1: the transform must be affine"
    largest = float(np.abs(matrix[:3, :3]).max())
    axes = np.linalg.svd(matrix[:3, :3] / (largest or 1.0), compute_uv=False)
    if not axes[2] * MOST_STRETCH >= axes[0] > 0.0:
        return "the transform flattens the mesh: it must be invertible"
    return None


def _from_quaternion(quaternion: list[float]) -> F8:
    scaled = np.array(quaternion, np.float64) / max(map(abs, quaternion))
    x, y, z, w = scaled / np.linalg.norm(scaled)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )


def _from_axis(rotation: AxisAngle) -> F8:
    """Rodrigues' formula."""
    scaled = np.array(rotation.axis, np.float64) / max(map(abs, rotation.axis))
    x, y, z = scaled / np.linalg.norm(scaled)
    angle = np.radians(np.remainder(rotation.angle_deg, 360.0))
    across = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.asarray(np.eye(3) + np.sin(angle) * across + (1.0 - np.cos(angle)) * (across @ across))
