"""A small measured ladder, with numbers of no particular meaning."""

from schemas.ladder import SAMPLES, Ladder, MeasuredRung, OutlineError, RungAtSize, ShadingError, Spread, ViewFacts
from schemas.render import Antialias, Source


def small_ladder() -> Ladder:
    """One rung in one size."""
    at_size = RungAtSize(
        size=256,
        bound_px=0.1,
        outline=OutlineError(alpha_error=0.01, alpha_rmse=0.02, distance_px=0.3, wrong_pixels=1.5),
        shading=ShadingError(psnr_db=38.0, ssim=0.99),
        frame=Spread(p50_ms=2.0, p95_ms=3.0),
        passes={"surface": Spread(p50_ms=1.0, p95_ms=1.5)},
    )
    rung = MeasuredRung(source=Source.CLIPPED, antialias=Antialias.COVERAGE, hull_faces=200, texels=256, sizes=[at_size])
    facts = ViewFacts(size=256, area_px=30_000.0, silhouette_edges=300.0)
    return Ladder(device="llvmpipe", views=12, samples=SAMPLES, facts=[facts], rungs=[rung])
