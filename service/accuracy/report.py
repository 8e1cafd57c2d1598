"""A mesh's ladder for one size and one device."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from schemas.errors import InvalidRequestError
from schemas.ladder import AccuracyReport, AccuracyRung, Front, Ladder
from service.accuracy.pareto import front

Times = Mapping[str, Mapping[int, Sequence[float]]]
"""Device -> size -> predicted median milliseconds of the ladder's rungs."""


def accuracy_report(mesh_id: str, name: str, ladder: Ladder, size: int | None, device: str | None, predicted: Times) -> AccuracyReport:
    """What there is to say. size: the nearest that was measured is taken, the largest for none. device: of the ladder, for none.

    predicted: times on devices that the ladder was not measured on. Raises InvalidRequestError for a device that nothing is known of.
    """
    sizes = [facts.size for facts in ladder.facts]
    chosen = sizes[-1] if size is None else min(sizes, key=lambda one: abs(math.log(one / max(size, 1))))
    devices = [ladder.device, *(other for other in predicted if other != ladder.device)]
    if device is not None and device not in devices:
        raise InvalidRequestError(f"Times are known of these devices: {'; '.join(devices)}.", field="device")
    times = None if device in (None, ladder.device) else predicted[device or ""][chosen]
    rungs = [_rung(ladder, number, chosen, None if times is None else times[number]) for number in range(len(ladder.rungs))]
    ms = [rung.ms for rung in rungs]
    return AccuracyReport(
        mesh=mesh_id,
        name=name,
        size=chosen,
        sizes=sizes,
        device=device or ladder.device,
        devices=devices,
        views=ladder.views,
        samples=ladder.samples,
        rungs=rungs,
        pareto=Front(outline=front([rung.alpha_error for rung in rungs], ms), shading=front([-rung.psnr_db for rung in rungs], ms)),
    )


def _rung(ladder: Ladder, number: int, size: int, predicted_ms: float | None) -> AccuracyRung:
    rung = ladder.rungs[number]
    at = next(one for one in rung.sizes if one.size == size)
    measured = predicted_ms is None
    return AccuracyRung(
        source=rung.source,
        antialias=rung.antialias,
        level=rung.level,
        hull_faces=rung.hull_faces,
        texels=rung.texels,
        name=rung.label,
        level_faces=rung.level_faces,
        bound_px=at.bound_px,
        alpha_error=at.outline.alpha_error,
        alpha_rmse=at.outline.alpha_rmse,
        distance_px=at.outline.distance_px,
        wrong_pixels=at.outline.wrong_pixels,
        psnr_db=at.shading.psnr_db,
        ssim=at.shading.ssim,
        ms=at.frame.p50_ms if measured else float(predicted_ms or 0.0),
        ms_p95=at.frame.p95_ms if measured else None,
        passes=at.passes if measured else {},
    )
