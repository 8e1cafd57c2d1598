"""What a request says of lines: which, how drawn, and how they look (names are final)."""

from __future__ import annotations

from enum import StrEnum
from typing import Literal

from pydantic import BaseModel, ConfigDict, Field, FiniteFloat

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
    """

    EDGE_MESH = "edge_mesh"
    WIREFRAME = "wireframe"
    TRANSLATED = "translated"
    FATTENED = "fattened"


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
    charcoal: bool = Field(False, description="fattened only: front faces seen nearly edge-on are made fatter too, and shaded (1 + V.N)/3")
    orientation: Literal["trusted", "any"] = Field(
        "trusted", description="any: faces may be turned any way; the nearest layer is found by an id buffer instead of by facing"
    )
    declutter: bool = Field(False, description="fattened only: widths shrink with the distance of the whole mesh beyond the fitting one")
