"""A view as query parameters, for `<img src>`: flat names in, a checked request out, faults by the flat names."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, Literal, TypeVar, get_args

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from schemas.errors import InvalidRequestError
from schemas.lines import LineKind, LineMethod, Stroke, StrokeBy
from schemas.render import (
    BUDGET,
    MAX_ERROR,
    Antialias,
    Fill,
    ImageFormat,
    PictureRequest,
    RenderRequest,
    ShadingMode,
    SilhouetteRequest,
    Source,
)
from schemas.sequence import MOST_FRAMES, USUAL_FRAMES, SequenceFormat, SequenceRequest
from service.errors import InvalidFieldsError, invalid_fields

Wanted = TypeVar("Wanted", RenderRequest, SilhouetteRequest, SequenceRequest)

DrawnKind = Literal["silhouette", "boundary", "ridge", "valley"]
QUERY_NAMES = {
    "camera.eye": "eye",
    "camera.target": "target",
    "camera.up": "up",
    "camera.fov_y_deg": "fov",
    "camera.projection": "projection",
    "camera.height": "height_units",
    "camera.orbit.azimuth_deg": "azimuth",
    "camera.orbit.elevation_deg": "elevation",
    "camera.orbit.distance": "distance",
    "camera.orbit.fov_y_deg": "fov",
    "shading.mode": "shading",
    "shading.color": "color",
    "shading.use_mesh_color": "mesh_color",
    "shading.light": "light",
    "shading.ambient": "ambient",
    "accuracy.antialias": "antialias",
    "accuracy.source": "source",
    "accuracy.smooth": "smooth",
    "accuracy.max_error_px": "max_error",
    "accuracy.budget_ms": "budget",
    "accuracy.min_psnr_db": "min_psnr",
    "accuracy.level": "level",
    "accuracy.hull_faces": "hull_faces",
    "accuracy.texels": "texels",
    "shading.fill": "fill",
    "lines": "lines",
    "lines.method": "lines",
    "lines.orientation": "line_orientation",
    "lines.charcoal": "charcoal",
    "lines.declutter": "declutter",
    **{f"lines.{kind}.{field}": f"line_{field}" for kind in get_args(DrawnKind) for field in ("width", "color", "opacity")},
    "lines.scale": "lines",
    "lines.stroke": "lines",
    **{f"{place}.{name}": f"stroke_{name}" for place in ("lines.stroke", "stroke") for name in Stroke.model_fields},
    "max_error_px": "max_error",
    "stroke": "kinds",
    "project.width": "width",
    "project.height": "height",
    "turn": "eye",
    "turn.frames": "frames",
    "turn.degrees": "degrees",
}
"""Field of a request body -> query parameter."""

ORBIT_ONLY = ("azimuth", "elevation", "distance")
STROKE_ONLY = {f"stroke_{name}" for name in Stroke.model_fields}
LINES_ONLY = {"line_kinds", "line_width", "line_color", "line_opacity", "line_orientation", "charcoal", "declutter"} | STROKE_ONLY
EYE_ONLY = ("target", "up", "projection", "height_units")


class CameraQuery(BaseModel):
    """A camera by orbit angles, or by `eye` and `target`, and the size of the image."""

    model_config = ConfigDict(extra="forbid")

    azimuth: float = Field(30.0, description="degrees about +y, from +z; orbit camera", examples=[30])
    elevation: float = Field(20.0, description="degrees towards +y, -90 to 90; orbit camera", examples=[20])
    distance: str = Field("fit", description="`fit`, or model units from the centre of the mesh; orbit camera", examples=["fit", "2.5"])
    fov: float = Field(45.0, description="vertical field of view in degrees, between 0 and 180", examples=[45])
    eye: str | None = Field(None, description="x,y,z in model units; instead of the orbit camera", examples=["0,0,3"])
    target: str | None = Field(None, description="x,y,z the camera looks at; default the origin; with `eye`", examples=["0,0,0"])
    up: str | None = Field(None, description="x,y,z that is up in the image; default 0,1,0; with `eye`", examples=["0,1,0"])
    projection: Literal["perspective", "orthographic"] = Field("perspective", description="`orthographic` needs `eye` and `height_units`")
    height_units: float | None = Field(None, description="model units the image is high; orthographic only", examples=[2.0])
    width: int = Field(512, description="pixels, 1 to 8192", examples=[512])
    height: int = Field(512, description="pixels, 1 to 8192", examples=[512])
    max_error: float | None = Field(None, description=MAX_ERROR, examples=[0.5])

    def camera(self) -> dict[str, Any]:
        """The camera as the request body has it. Raises InvalidRequestError where both forms are mixed."""
        given = self.model_fields_set
        if self.eye is None:
            for name in EYE_ONLY:
                if name in given:
                    raise InvalidRequestError(f"{name} needs eye: without it the camera is an orbit.", field=name)
            distance: str | float = "fit" if self.distance == "fit" else _number(self.distance, "distance")
            return {"orbit": {"azimuth_deg": self.azimuth, "elevation_deg": self.elevation, "distance": distance, "fov_y_deg": self.fov}}
        for name in ORBIT_ONLY:
            if name in given:
                raise InvalidRequestError(f"{name} and eye cannot be combined: the one is an orbit, the other a place.", field=name)
        camera: dict[str, Any] = {"eye": vector(self.eye, "eye"), "fov_y_deg": self.fov, "projection": self.projection}
        camera |= {name: vector(text, name) for name, text in (("target", self.target), ("up", self.up)) if text is not None}
        return camera | ({} if self.height_units is None else {"height": self.height_units})


class StrokeQuery(BaseModel):
    """How lines change along themselves; a stroke is asked for by any of these."""

    stroke_width_by: StrokeBy | None = Field(None, description="what the width of lines follows", examples=["depth"])
    stroke_opacity_by: StrokeBy | None = Field(None, description="what the opacity of lines follows", examples=["curvature"])
    stroke_least: float = Field(0.25, description="share of width and opacity where a line is weakest", examples=[0.1])
    stroke_nib_deg: float = Field(40.0, description="direction of the nib, of `angle`: 0 to the right, 90 upwards", examples=[30])
    stroke_dash: str | None = Field(None, description="pixels along the line: dash,gap,dash,gap,...", examples=["12,6"])
    stroke_wobble_px: float = Field(0.0, description="pixels by which lines leave where they are, at most", examples=[2.0])
    stroke_wobble_length_px: float = Field(40.0, description="pixels from one sway of the wobble to the next", examples=[40.0])
    stroke_seed: int = Field(0, description="of the wobble: the same gives the same lines", examples=[1])

    def stroke(self) -> dict[str, Any] | None:
        """The stroke as a request body has it, None where nothing of it is given. Raises InvalidRequestError for a dash of no numbers."""
        given = {name.removeprefix("stroke_"): getattr(self, name) for name in self.model_fields_set & STROKE_ONLY}
        if isinstance(given.get("dash"), str):
            given["dash"] = [_number(part, "stroke_dash") for part in given["dash"].split(",")]
        return given or None


class SilhouetteQuery(CameraQuery, StrokeQuery):
    """A silhouette projected into an image."""

    contours: bool = Field(True, description="link the edges into closed contours")
    positions: bool = Field(True, description="include the positions of the vertices")
    smooth: bool = Field(False, description="contours of the surface with interpolated normals, as curves")
    kinds: str | None = Field(None, description="lines of these kinds, with commas between", examples=["silhouette,boundary,ridge"])
    visible_only: bool = Field(False, description="lines without what is hidden")
    ridge_deg: float = Field(60.0, description="degrees by which normals turn at a ridge, at least", examples=[40])
    valley_deg: float = Field(60.0, description="degrees by which normals turn at a valley, at least", examples=[40])
    crease_deg: float = Field(60.0, description="degrees by which normals turn at a crease, at least", examples=[40])
    simplify_px: float | None = Field(None, description="leave out points of lines that are so near to what remains", examples=[0.5])
    smooth_px: float | None = Field(None, description="round corners of lines, at most so far from where they are", examples=[0.5])
    line_width: float | None = Field(None, description="pixels, of all lines of a drawing", examples=[1.5])

    def request(self) -> SilhouetteRequest:
        """The same as a request body. Raises InvalidFieldsError and InvalidRequestError with query names."""
        project = {"width": self.width, "height": self.height}
        return _checked(
            SilhouetteRequest,
            camera=self.camera(),
            project=project,
            contours=self.contours,
            positions=self.positions,
            smooth=self.smooth,
            max_error_px=self.max_error,
            kinds=None if self.kinds is None else self.kinds.split(","),
            visible_only=self.visible_only,
            ridge_deg=self.ridge_deg,
            valley_deg=self.valley_deg,
            crease_deg=self.crease_deg,
            simplify_px=self.simplify_px,
            smooth_px=self.smooth_px,
            line_width={} if self.line_width is None else dict.fromkeys(LineKind, self.line_width),
            stroke=self.stroke(),
        )


class RenderQuery(CameraQuery, StrokeQuery):
    """A picture."""

    background: str = Field("transparent", description="`transparent` or rrggbb", examples=["transparent", "ffffff"])
    shading: ShadingMode = Field(ShadingMode.LAMBERT, description="how the surface is shaded")
    color: str = Field("c8c8c8", description="rrggbb of the surface where the mesh has no colour", examples=["e0a050"])
    mesh_color: bool = Field(True, description="use the mesh's own colours when it has them")
    light: str | None = Field(None, description="x,y,z towards the light, in camera space", examples=["1,1,2"])
    ambient: float = Field(0.25, description="light from everywhere, 0 to 1")
    antialias: Antialias = Field(Antialias.AUTO, description="how the outline is smoothed; `msaa` and `ssaa` draw the original")
    source: Source = Field(Source.AUTO, description="draw the clipped hull or the original mesh")
    smooth: bool = Field(False, description="curve the outline by the surface's normals, for coarse meshes; only with `coverage`")
    budget: float | None = Field(None, description=BUDGET, examples=[5.0])
    min_psnr: float | None = Field(None, description="decibels that shading must reach where it was measured", examples=[35.0])
    level: int | None = Field(None, description="number of the level that the outline is taken from, finest first; -1 is the mesh")
    hull_faces: int | None = Field(None, description="draw the mesh's hull whose number of faces is nearest to this", examples=[1000])
    texels: int | None = Field(None, description="draw with maps of at most so many texels a side, or the smallest", examples=[512])

    fill: Fill = Field(Fill.SHADED, description="under lines: the shaded surface, a white one, or nothing but the lines")
    lines: LineMethod | None = Field(None, description="lines in the picture, and how they are drawn", examples=["fattened"])
    line_kinds: str = Field("silhouette,boundary", description="which: silhouette, boundary, ridge, valley, with commas between")
    line_width: float = Field(1.5, description="pixels", examples=[2.0])
    line_color: str = Field("000000", description="rrggbb", examples=["203040"])
    line_opacity: float = Field(1.0, description="0 to 1")
    line_orientation: Literal["trusted", "any"] = Field("trusted", description="`any`: faces may be turned any way")
    charcoal: bool = Field(False, description="only `fattened`: rims of faces seen nearly edge-on too")
    declutter: bool = Field(False, description="only `fattened`: thinner lines where the mesh is far away")

    def request(self, image_format: ImageFormat) -> RenderRequest:
        """The same as a request body. Raises InvalidFieldsError and InvalidRequestError with query names."""
        return _checked(
            RenderRequest,
            camera=self.camera(),
            width=self.width,
            height=self.height,
            background=self.background if self.background == "transparent" else _hash(self.background),
            shading={
                "mode": self.shading,
                "color": _hash(self.color),
                "use_mesh_color": self.mesh_color,
                "light": None if self.light is None else vector(self.light, "light"),
                "ambient": self.ambient,
                "fill": self.fill,
            },
            lines=self._lines(),
            accuracy={
                "antialias": self.antialias,
                "source": self.source,
                "smooth": self.smooth,
                "max_error_px": self.max_error,
                "budget_ms": self.budget,
                "min_psnr_db": self.min_psnr,
                "level": self.level,
                "hull_faces": self.hull_faces,
                "texels": self.texels,
            },
            format=image_format,
        )

    def _lines(self) -> dict[str, Any] | None:
        """The lines as the request body has them. Raises InvalidRequestError for kinds that there are not, or looks without lines."""
        if self.lines is None:
            for name in sorted(self.model_fields_set & LINES_ONLY):
                raise InvalidRequestError(f"{name} needs lines, which says how they are drawn.", field=name)
            return None
        kinds = {kind.strip() for kind in self.line_kinds.split(",")}
        if not kinds <= set(get_args(DrawnKind)):
            raise InvalidRequestError("line_kinds must be of silhouette, boundary, ridge and valley.", field="line_kinds")
        style = {"width": self.line_width, "color": _hash(self.line_color), "opacity": self.line_opacity}
        given = {kind: style if kind in kinds else None for kind in get_args(DrawnKind)}
        more = {"charcoal": self.charcoal, "declutter": self.declutter, "orientation": self.line_orientation, "stroke": self.stroke()}
        return {"method": self.lines, **given, **more}


class ThumbnailQuery(BaseModel):
    """A picture with nothing to choose but its size."""

    size: int = Field(256, ge=16, le=1024, description="pixels a side", examples=[256])


class TurntableQuery(RenderQuery):
    """A picture that turns round."""

    frames: int = Field(USUAL_FRAMES, description=f"how many, 1 to {MOST_FRAMES}", examples=[36])
    degrees: float = Field(360.0, description="how far round; below 0 the other way")
    fps: float = Field(25.0, description="frames a second, 0.1 to 100", examples=[25])
    loop: int = Field(0, description="times that it is played, 0 for ever")

    def sequence(self, form: SequenceFormat) -> SequenceRequest:
        """The same as a request body. Raises InvalidFieldsError and InvalidRequestError with query names."""
        picture = self.request(ImageFormat.PNG)
        fields = {name: getattr(picture, name) for name in PictureRequest.model_fields}
        turn = {"frames": self.frames, "degrees": self.degrees}
        return _checked(SequenceRequest, **fields, turn=turn, fps=self.fps, loop=self.loop, format=form)


def vector(text: str, field: str) -> list[float]:
    """Three numbers with commas between. Raises InvalidRequestError."""
    parts = text.split(",")
    if len(parts) != 3:
        raise InvalidRequestError(f"{field} must be three numbers with commas between, like 0,0,3.", field=field)
    return [_number(part, field) for part in parts]


@contextmanager
def query_names() -> Iterator[None]:
    """Inside, an InvalidRequestError about a field of the body becomes one about the query parameter."""
    try:
        yield
    except InvalidRequestError as error:
        field = error.where.get("field")
        if field not in QUERY_NAMES:
            raise
        name = QUERY_NAMES[field]
        where = error.where | {"field": name}
        raise type(error)(error.message.replace(field, name), code=error.code, **where) from error


def _number(text: str, field: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise InvalidRequestError(f"{field} must be a number.", field=field) from None


def _hash(color: str) -> str:
    return color if color.startswith("#") else f"#{color}"


def _checked(model: type[Wanted], **fields: Any) -> Wanted:
    try:
        return model.model_validate(fields)
    except ValidationError as error:
        raise InvalidFieldsError(invalid_fields(error.errors(), QUERY_NAMES)) from error
