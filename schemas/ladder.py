"""The measured ladder: how exact every rung is, and what it costs; what the stage `measure` stores and what the API answers.

Errors belong to a mesh, times to a device. All errors are against the original, supersampled.
"""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict, Field

from schemas.render import Antialias, Source

SIZES = (256, 512)
"""Sides of the measured pictures, pixels."""
VIEWS = 12
SAMPLES = 16
"""Samples of the reference along each side of a pixel."""


class RungKey(BaseModel):
    """Which rung. level: number of the level whose silhouette is the outline, finest first; None for the mesh's own."""

    model_config = ConfigDict(frozen=True)

    source: Source
    antialias: Antialias
    level: int | None = None
    hull_faces: int | None = Field(None, description="faces of the hull that is drawn; none where the original is")
    texels: int | None = Field(None, description="longest side of the maps over it, texels")

    @property
    def label(self) -> str:
        """For people: source/antialias, and what else tells it from others."""
        parts = [f"{self.source.value}/{self.antialias.value}"]
        parts += [] if self.level is None else [f"level {self.level}"]
        parts += [] if self.hull_faces is None else [f"{self.hull_faces} faces"]
        parts += [] if self.texels is None else [f"{self.texels} texels"]
        return ", ".join(parts)


class OutlineError(BaseModel):
    """Of alpha, over all views. Boundary pixels are those that the original covers in part."""

    alpha_error: float = Field(description="mean absolute error of alpha on the boundary pixels, 0..1")
    alpha_rmse: float = Field(description="root mean square of the same")
    distance_px: float = Field(description="largest distance between the outline and the original's, pixels, over all views")
    wrong_pixels: float = Field(description="pixels a view whose alpha is off by more than one half")


class ShadingError(BaseModel):
    """Of colour, over pixels that both cover fully."""

    psnr_db: float = Field(description="peak signal to noise of sRGB bytes, decibels")
    ssim: float = Field(description="structural similarity of luma, 0..1")


class Spread(BaseModel):
    """Median and 95th percentile, milliseconds."""

    p50_ms: float
    p95_ms: float


class RungAtSize(BaseModel):
    """One rung in pictures of one size. bound_px: the largest certified bound of the views; None where nothing is certified."""

    size: int
    bound_px: float | None
    outline: OutlineError
    shading: ShadingError
    frame: Spread = Field(description="from the resolved request to pixels in memory")
    passes: dict[str, Spread]


class MeasuredRung(RungKey):
    """A rung and what was measured of it. level_faces: of the surface whose silhouette is the outline."""

    level_faces: int | None = None
    sizes: list[RungAtSize]


class ViewFacts(BaseModel):
    """Of the measured views of one size, medians: what times are predicted from."""

    size: int
    area_px: float = Field(description="pixels of the rectangle that is drawn")
    silhouette_edges: float = Field(description="edges of the mesh's silhouette")


class Ladder(BaseModel):
    """What the stage `measure` stores. device: the renderer string of the GL that the times belong to."""

    device: str
    views: int
    samples: int = Field(description="of the reference, along each side of a pixel")
    facts: list[ViewFacts]
    rungs: list[MeasuredRung]


class Front(BaseModel):
    """Numbers of the rungs that no other one beats in both error and time, the fastest first."""

    outline: list[int] = Field(description="by alpha_error and ms")
    shading: list[int] = Field(description="by psnr_db and ms")


class AccuracyRung(RungKey):
    """A line of the answer."""

    name: str
    level_faces: int | None = None
    bound_px: float | None = Field(
        None, description="certified: the outline is never further off in these views; none where that is not known"
    )
    alpha_error: float
    alpha_rmse: float
    distance_px: float
    wrong_pixels: float
    psnr_db: float
    ssim: float
    ms: float = Field(description="median of a frame on the device, measured or predicted")
    ms_p95: float | None = Field(None, description="95th percentile; none where times are predicted")
    passes: dict[str, Spread] = {}


class AccuracyReport(BaseModel):
    """What `GET /v1/meshes/{id}/accuracy` answers."""

    mesh: str
    name: str
    size: int = Field(description="pictures are so many pixels wide and high")
    sizes: list[int] = Field(description="sizes that were measured: `?size=`")
    device: str = Field(description="renderer that the times belong to")
    devices: list[str] = Field(description="renderers that times are known of: `?device=`")
    views: int
    samples: int
    rungs: list[AccuracyRung]
    pareto: Front
