"""What a request says of lines: which, how drawn, and how they look (names are final)."""

from __future__ import annotations

from enum import StrEnum
from typing import Annotated, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, FiniteFloat, model_validator
from pydantic_core import PydanticCustomError

COLOR = r"^#[0-9a-fA-F]{6}$"


class _Part(BaseModel):
    model_config = ConfigDict(extra="forbid")


class LineKind(StrEnum):
    """What makes a line of an edge, or of two faces. An edge that is several is the first of those that are asked for.

    silhouette: one of its two faces is front-facing. boundary: it has one face. ridge, valley, crease: its faces turn by more than an
    angle, convex, concave, or either way; an edge of more than two faces is a crease. intersection: faces cross or touch there.
    """

    SILHOUETTE = "silhouette"
    BOUNDARY = "boundary"
    RIDGE = "ridge"
    VALLEY = "valley"
    CREASE = "crease"
    INTERSECTION = "intersection"


class LineMethod(StrEnum):
    """How lines are drawn into a picture.

    edge_mesh: two quads an edge that the GL shows where the edge is a line (Fast Silhouettes); every kind, needs edges that faces share.
    wireframe, translated, fattened: back faces drawn as lines, pulled towards the eye, or made fatter (Image Precision Silhouette
    Edges, sections 3.1 to 3.3); any triangles at all, no preprocessing.
    strokes: the exact visible lines as polylines, rounded within a pixel, drawn as `Lines.stroke` says.
    """

    EDGE_MESH = "edge_mesh"
    WIREFRAME = "wireframe"
    TRANSLATED = "translated"
    FATTENED = "fattened"
    STROKES = "strokes"


class LineStyle(_Part):
    """How the lines of one kind look."""

    width: FiniteFloat = Field(
        1.5, gt=0.0, le=64.0, description="pixels; of an image-precision method's silhouettes, where it keeps widths"
    )
    color: str = Field("#000000", pattern=COLOR)
    opacity: FiniteFloat = Field(1.0, ge=0.0, le=1.0)


class Pull(_Part):
    """How back faces are pulled towards the eye (section 3.2)."""

    by: Literal["fixed", "z", "offset"] = Field(
        "z", description="a fixed distance; a share of the distance from the eye; or the GL's polygon offset, which sees slopes too"
    )
    amount: FiniteFloat | None = Field(
        None, gt=0.0, description="radii of the mesh; share of the distance; offset factor. A fitting one if not given"
    )


StrokeBy = Literal["depth", "curvature", "angle"]
MOST_DASHES = 16
SHORTEST_DASH_PX, LONGEST_DASH_PX = 1.0, 1000.0
DashLength = Annotated[FiniteFloat, Field(ge=SHORTEST_DASH_PX, le=LONGEST_DASH_PX)]


class Stroke(_Part):
    """How lines change along themselves, as those of a hand do: width and opacity, dashes, and a wobble.

    By depth a line is strongest at the mesh's nearest depth in the view and weakest at its farthest; by curvature it is strongest where
    it turns by 30 degrees or more within 24 pixels of the image, and weakest where it is straight; by angle it is strongest
    across the nib and weakest along it, as that of a broad pen.
    """

    width_by: StrokeBy | None = Field(None, description="what the width follows; none: the same everywhere")
    opacity_by: StrokeBy | None = Field(None, description="what the opacity follows; none: the same everywhere")
    least: FiniteFloat = Field(0.25, ge=0.0, le=1.0, description="share of width and opacity where a line is weakest")
    nib_deg: FiniteFloat = Field(
        40.0, ge=-360.0, le=360.0, description="direction of the nib in the image, of `angle`: 0 to the right, 90 upwards"
    )
    dash: list[DashLength] | None = Field(
        None, min_length=2, max_length=MOST_DASHES, description="pixels along the line: dash, gap, dash, gap, ...; of visible lines"
    )
    wobble_px: FiniteFloat = Field(0.0, ge=0.0, le=64.0, description="pixels by which lines leave where they are, at most")
    wobble_length_px: FiniteFloat = Field(40.0, ge=2.0, le=1000.0, description="pixels from one sway of the wobble to the next")
    seed: int = Field(0, ge=0, le=2**32 - 1, description="of the wobble: the same gives the same lines")

    @model_validator(mode="after")
    def _paired(self) -> Self:
        if self.dash is not None and len(self.dash) % 2:
            raise PydanticCustomError("unpaired_dash", "a dash has a gap after it: an even count of lengths", {"field": "dash"})
        return self


class Lines(_Part):
    """Lines in a picture. A kind that is null is not drawn."""

    method: LineMethod = LineMethod.EDGE_MESH
    silhouette: LineStyle | None = LineStyle()
    boundary: LineStyle | None = LineStyle()
    ridge: LineStyle | None = None
    valley: LineStyle | None = None
    ridge_deg: FiniteFloat = Field(60.0, ge=0.0, le=180.0, description="a convex edge is a ridge where normals turn by more than this")
    valley_deg: FiniteFloat = Field(60.0, ge=0.0, le=180.0, description="a concave edge is a valley where normals turn by more than this")
    scale: Literal["pixels", "distance"] = Field(
        "pixels", description="widths everywhere the same, or that of the middle of the mesh, less behind it and more before it"
    )
    pull: Pull = Pull()
    charcoal: bool = Field(
        False, strict=True, description="fattened only: front faces seen nearly edge-on are made fatter too, and shaded (1 + V.N)/3"
    )
    orientation: Literal["trusted", "any"] = Field(
        "trusted", description="any: faces may be turned any way; the nearest layer is found by an id buffer instead of by facing"
    )
    declutter: bool = Field(
        False, strict=True, description="fattened only: widths shrink with the distance of the whole mesh beyond the fitting one"
    )
    stroke: Stroke | None = Field(None, description="strokes only: how lines change along themselves; the same everywhere if not given")
