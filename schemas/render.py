"""Requests for pictures and silhouettes (names are final)."""

from __future__ import annotations

import math
from enum import StrEnum
from typing import Annotated, Any, Literal, Self

from pydantic import BaseModel, ConfigDict, Discriminator, Field, FiniteFloat, Tag, model_validator
from pydantic_core import PydanticCustomError

from schemas.lines import LineKind, Lines, Stroke

MAX_SIDE_PX = 8192
Vector = Annotated[list[FiniteFloat], Field(min_length=3, max_length=3)]


class _Request(BaseModel):
    model_config = ConfigDict(extra="forbid")


def _wrong(field: str, message: str) -> PydanticCustomError:
    """A fault between fields, charged to the one field (in the error's `ctx`) that a caller would change."""
    return PydanticCustomError("unusable_camera", message, {"field": field})


class Camera(_Request):
    """A camera by eye and target, in model units. Looks from `eye` to `target`; `up` is up in the image."""

    eye: Vector
    target: Vector = [0.0, 0.0, 0.0]
    up: Vector = [0.0, 1.0, 0.0]
    fov_y_deg: FiniteFloat = Field(45.0, gt=0.0, lt=180.0)
    projection: Literal["perspective", "orthographic"] = "perspective"
    height: FiniteFloat | None = Field(None, gt=0.0, description="orthographic only: model units the image is high")

    @model_validator(mode="after")
    def _usable(self) -> Self:
        if self.eye == self.target:
            raise _wrong("eye", "eye and target are the same point")
        if not any(self.up):
            raise _wrong("up", "up is the zero vector")
        view = [t - e for t, e in zip(self.target, self.eye, strict=True)]
        scale_view, scale_up = max(map(abs, view)), max(map(abs, self.up))
        if not (math.isfinite(scale_view) and scale_view > 0.0):
            raise _wrong("eye", "eye and target are too far apart")
        v, u = [x / scale_view for x in view], [x / scale_up for x in self.up]
        cross = [v[1] * u[2] - v[2] * u[1], v[2] * u[0] - v[0] * u[2], v[0] * u[1] - v[1] * u[0]]
        if max(map(abs, cross)) < 1e-9:
            raise _wrong("up", "up is parallel to the viewing direction")
        if self.projection == "orthographic" and self.height is None:
            raise _wrong("height", "height is required for an orthographic camera")
        return self


class Orbit(_Request):
    """A camera on a sphere around the mesh: azimuth turns about +y from +z, elevation rises towards +y."""

    azimuth_deg: FiniteFloat = 0.0
    elevation_deg: FiniteFloat = Field(0.0, ge=-90.0, le=90.0)
    distance: Literal["fit"] | Annotated[FiniteFloat, Field(gt=0.0)] = "fit"
    fov_y_deg: FiniteFloat = Field(45.0, gt=0.0, lt=180.0)


class OrbitCamera(_Request):
    """The orbit form of a camera: the mesh's bounding sphere is the centre; distance in model units or "fit"."""

    orbit: Orbit


def _camera_form(value: object) -> str:
    orbit = "orbit" in value if isinstance(value, dict) else isinstance(value, OrbitCamera)
    return CAMERA_FORMS[1] if orbit else CAMERA_FORMS[0]


CAMERA_FORMS = ("camera by eye", "camera by orbit")
"""Names of the two forms inside error locations; faults are reported for the form that was meant, not for both."""

AnyCamera = Annotated[Annotated[Camera, Tag(CAMERA_FORMS[0])] | Annotated[OrbitCamera, Tag(CAMERA_FORMS[1])], Discriminator(_camera_form)]


class ShadingMode(StrEnum):
    """How the surface is shaded; `mask` is the silhouette's coverage alone, in `color`.

    gooch: from cool to warm as it turns to the light (Gooch 1998). flat: lambert with the normals of faces. depth: the nearer the
    lighter. matcap: lit as a ball of clay that turns with the camera. These four are drawn on the mesh itself.
    """

    LAMBERT = "lambert"
    NORMAL = "normal"
    MASK = "mask"
    GOOCH = "gooch"
    FLAT = "flat"
    DEPTH = "depth"
    MATCAP = "matcap"


class Fill(StrEnum):
    """What surfaces under lines look like; whatever it is, they hide lines behind them."""

    SHADED = "shaded"
    WHITE = "white"
    NONE = "none"


class Shading(_Request):
    """Surface appearance."""

    mode: ShadingMode = ShadingMode.LAMBERT
    color: str = Field("#c8c8c8", pattern=r"^#[0-9a-fA-F]{6}$", description="sRGB surface colour where the mesh has none")
    use_mesh_color: bool = Field(True, strict=True, description="use the mesh's own colours when it has them")
    light: Vector | None = Field(None, description="direction towards the light in camera space; default: up, right and behind the eye")
    ambient: FiniteFloat = Field(0.25, ge=0.0, le=1.0)
    fill: Fill = Field(Fill.SHADED, description="under lines: the shaded surface, a white one, or nothing but the lines")


class Antialias(StrEnum):
    """Rungs of silhouette antialiasing; msaa and ssaa are for the original only. auto: coverage, or whatever keeps the asked accuracy."""

    AUTO = "auto"
    NONE = "none"
    LINE = "line"
    COVERAGE = "coverage"
    MSAA = "msaa"
    SSAA = "ssaa"


class Source(StrEnum):
    """What is drawn: the clipped hull or the original mesh."""

    AUTO = "auto"
    CLIPPED = "clipped"
    ORIGINAL = "original"


MAX_ERROR = "pixels by which the outline may be off the mesh's, so that a coarser surface can stand for the mesh; exact if not given"
BUDGET = "milliseconds that drawing may take; the most accurate picture that is predicted to fit is drawn"


class Accuracy(_Request):
    """How exact the picture must be, and what it may cost.

    With max_error_px the cheapest way that keeps the bound is taken, with budget_ms the most accurate one that fits; with both the
    bound wins. What else is given narrows the choice. With neither, what is not given is as exact as it can be.
    """

    antialias: Antialias = Antialias.AUTO
    source: Source = Source.AUTO
    smooth: bool = Field(
        False, strict=True, description="curve the outline by the surface's normals, for coarse meshes; only with coverage"
    )
    max_error_px: FiniteFloat | None = Field(None, gt=0.0, description=MAX_ERROR)
    budget_ms: FiniteFloat | None = Field(None, gt=0.0, description=BUDGET)
    min_psnr_db: FiniteFloat | None = Field(None, gt=0.0, description="decibels that shading must reach where it was measured")
    level: int | None = Field(None, ge=-1, description="number of the level that the outline is taken from, finest first; -1 is the mesh")
    hull_faces: int | None = Field(None, ge=4, description="draw the mesh's hull whose number of faces is nearest to this")
    texels: int | None = Field(None, ge=1, description="draw with maps of at most so many texels a side, or the smallest")


class ImageFormat(StrEnum):
    """Image encodings; raw is width * height * 4 bytes, RGBA, sRGB, straight alpha, top row first."""

    PNG = "png"
    WEBP = "webp"
    JPEG = "jpeg"
    RAW = "raw"


class PictureRequest(_Request):
    """What a picture shows and how, whatever it is encoded as."""

    camera: AnyCamera = OrbitCamera(orbit=Orbit(azimuth_deg=30.0, elevation_deg=20.0))
    width: int = Field(512, ge=1, le=MAX_SIDE_PX)
    height: int = Field(512, ge=1, le=MAX_SIDE_PX)
    background: str = Field("transparent", pattern=r"^(transparent|#[0-9a-fA-F]{6})$")
    shading: Shading = Shading()
    accuracy: Accuracy = Accuracy()
    lines: Lines | None = Field(None, description="lines in the picture, which then is drawn from the original mesh")


class RenderRequest(PictureRequest):
    """One picture."""

    format: ImageFormat | None = Field(None, description="overrides the Accept header")


class ProjectTo(_Request):
    """Image to project silhouette vertices into, pixels."""

    width: int = Field(512, ge=1, le=MAX_SIDE_PX)
    height: int = Field(512, ge=1, le=MAX_SIDE_PX)


Width = Annotated[FiniteFloat, Field(gt=0.0, le=64.0)]


class SilhouetteRequest(_Request):
    """One silhouette; with `kinds` or `visible_only` also lines, as polylines in the image, told apart by whether they are hidden."""

    camera: AnyCamera = OrbitCamera(orbit=Orbit(azimuth_deg=30.0, elevation_deg=20.0))
    contours: bool = Field(True, strict=True, description="link the edges into closed contours")
    positions: bool = Field(True, strict=True, description="include the positions of the vertices, model units")
    project: ProjectTo | None = Field(None, description="include the vertices' pixel coordinates in an image of this size")
    smooth: bool = Field(
        False, strict=True, description="add the contours of the surface with interpolated normals, as curves; needs `project`"
    )
    max_error_px: FiniteFloat | None = Field(None, gt=0.0, description=MAX_ERROR + "; needs `project`")
    kinds: list[LineKind] | None = Field(
        None, min_length=1, description='lines of these kinds, of any mesh; ["silhouette"] with `visible_only`, else none; needs `project`'
    )
    visible_only: bool = Field(False, strict=True, description="lines without what is hidden; otherwise that comes marked; needs `project`")
    ridge_deg: FiniteFloat = Field(60.0, ge=0.0, le=180.0, description="a convex edge is a ridge where normals turn by more than this")
    valley_deg: FiniteFloat = Field(60.0, ge=0.0, le=180.0, description="a concave edge is a valley where normals turn by more than this")
    crease_deg: FiniteFloat = Field(60.0, ge=0.0, le=180.0, description="an edge is a crease where normals turn by more than this")
    simplify_px: FiniteFloat | None = Field(None, gt=0.0, description="leave out points of lines that are so near to what remains, pixels")
    smooth_px: FiniteFloat | None = Field(None, gt=0.0, description="round corners of lines, at most so far from where they are, pixels")
    line_width: dict[LineKind, Width] = Field({}, description="pixels; of drawings")
    stroke: Stroke | None = Field(None, description="how lines change along themselves; needs lines: `kinds` or `visible_only`")

    @property
    def wants_lines(self) -> bool:
        """Whether polylines are asked for."""
        return self.visible_only or self.kinds is not None


class Surface(BaseModel):
    """What a silhouette is of. level: whether it is not the mesh but a hull near it; then vertex numbers are the hull's."""

    level: bool
    faces: int
    error_px: float = Field(description="how far the shape in the image can be beyond the mesh's, pixels; 0 for the mesh itself")


class Line(BaseModel):
    """A polyline in the image."""

    kind: LineKind
    visible: bool
    closed: bool = Field(description="the last point joins the first")
    points: list[tuple[float, float]] = Field(description="pixels")
    vertices: list[int | None] | None = Field(
        None, description="the mesh's vertex at each point, null for a cut; not of smooth lines and strokes"
    )
    widths: list[float] | None = Field(None, description="pixels, at each point; of strokes whose width follows something")
    opacities: list[float] | None = Field(None, description="0 to 1, at each point; of strokes whose opacity follows something")


class Silhouette(BaseModel):
    """The answer, as documented; the service writes it from arrays without building this model."""

    eye: list[float] = Field(description="homogeneous, model units: [x, y, z, 1], or [dx, dy, dz, 0] towards an orthographic viewer")
    edge_count: int
    edges: list[tuple[int, int]] = Field(description="directed vertex pairs; the front-facing side is on the left seen from outside")
    contours: list[list[int]] | None = Field(None, description="closed: the last vertex joins the first")
    curves: list[list[tuple[float, float]]] | None = Field(
        None,
        description="smooth contours, closed, in pixels: node, two control points of a cubic Bezier curve, node, ..., two control points",
    )
    lines: list[Line] | None = Field(None, description="of the kinds asked for, by kind, visible ones first")
    surface: Surface = Field(description="whose edges and vertices these are: the mesh's, or those of a level that stands for it")
    vertices: dict[str, Any] = Field(
        {}, description='{"index": [...], "position": [[x, y, z], ...], "pixel": [[x, y], ...]} of the vertices used'
    )
