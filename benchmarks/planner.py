"""How good the planner is: predicted against observed times, its choice against the best rung found by trying all, and what planning takes.

    python -m benchmarks.planner MESH [--seed 1] [--json]

MESH is a file or a name that `benchmarks.models` knows. The device is calibrated as at the start of the service, and the mesh's ladder is
not used: everything is learnt from frames. First every rung is drawn ROUNDS times, as in a service that has been used for a while.
Then TURNS times a client asks for a random rung, size and view and turns the mesh: the first WARM_FRAMES frames are to get warm, and for
each of the FRAMES after these, what was predicted before it was drawn is held against what it took.
Then REQUESTS random requests with a bound, a budget, or both. For each, all rungs that may be drawn are drawn in this view, the fastest
of them again and again; the best of those is the one the rules of `accuracy` name, with these times instead of predicted ones. The
planner's choice is right when it is that rung, or keeps the same promises and takes at most CLOSE times as long; `as_accurate` says
whether it is at least as accurate, too.
"""

from __future__ import annotations

import math
import statistics
import sys
import time
from collections.abc import Callable
from concurrent.futures import Future
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.frame import prepare
from benchmarks.models import mesh_file
from benchmarks.report import mesh_parser, report
from schemas.mesh import PreprocessOptions
from schemas.render import Accuracy, Orbit, OrbitCamera, RenderRequest
from service.assets import MeshAsset
from service.camera import View, resolve_camera
from service.costs import ViewTerms
from service.measure.ladder import explicit
from service.render.calibration import calibrate
from service.render.choice import CERTAIN, Choice, choose
from service.render.frame import RenderedImage, render_frame
from service.render.plan import plan_frame
from service.render.state import Gpu

TURNS, FRAMES, WARM_FRAMES, REQUESTS = 50, 4, 2, 30
TURN_DEG = 18.0
ROUNDS = 3
"""Every rung is drawn so often before anything is measured."""
CLOSE = 1.15
WITHIN = 0.25
SIDES_PX = (128, 256, 400, 512, 800)
AGAIN, BEST_OF = 6, 5
"""The fastest so many are drawn again so often."""
PLANS = 500


def calibrated(cache_mib: int = 1024) -> tuple[Gpu, float]:
    """A GL whose costs are known as after the start of the service, and the seconds that took."""
    gpu = Gpu(cache_mib)

    def submit(asset: MeshAsset, request: RenderRequest) -> Future[RenderedImage]:
        done: Future[RenderedImage] = Future()
        done.set_result(render_frame(gpu, asset, request, true_times=True))
        return done

    calibrate(submit)  # compiles
    start = time.perf_counter()
    gpu.costs.recalibrate(calibrate(submit))
    return gpu, time.perf_counter() - start


class Random:
    """Random views and requests."""

    def __init__(self, asset: MeshAsset, seed: int) -> None:
        self._asset, self._random = asset, np.random.default_rng(seed)

    def number(self) -> int:
        """Of a rung."""
        return int(self._random.integers(len(self._asset.rungs.rungs)))

    def request(self, accuracy: Accuracy) -> RenderRequest:
        """A view from anywhere, in a picture of one of SIDES_PX."""
        azimuth, height = self._random.uniform(0.0, 360.0), self._random.uniform(-0.95, 0.95)
        orbit = Orbit(azimuth_deg=azimuth, elevation_deg=math.degrees(math.asin(height)))
        side = int(self._random.choice(SIDES_PX))
        return RenderRequest(camera=OrbitCamera(orbit=orbit), width=side, height=side, accuracy=accuracy)

    def accuracy(self) -> Accuracy:
        """A bound, a budget, or both."""
        bound = float(np.exp(self._random.uniform(math.log(0.01), math.log(8.0))))
        budget = float(np.exp(self._random.uniform(math.log(0.8), math.log(25.0))))
        kind = self._random.integers(3)
        return Accuracy(max_error_px=bound if kind != 1 else None, budget_ms=budget if kind != 0 else None)


def predictions(gpu: Gpu, asset: MeshAsset, random: Random) -> list[float]:
    """predicted / observed of all frames that count."""
    ratios = []
    for _ in range(TURNS):
        request = random.request(explicit(asset.rungs, random.number()))
        for turn in range(WARM_FRAMES + FRAMES):
            turned = turned_by(request, turn * TURN_DEG)
            view = resolve_camera(turned.camera, asset.frame, turned.width, turned.height, asset.radius)
            predicted = plan_frame(turned, asset, view, gpu.costs).choice.predicted_ms
            ratio = predicted / draw(gpu, asset, turned)
            ratios += [ratio] if turn >= WARM_FRAMES else []
    return ratios


def turned_by(request: RenderRequest, azimuth_deg: float) -> RenderRequest:
    """The request for an orbit further on."""
    assert isinstance(request.camera, OrbitCamera)
    orbit = request.camera.orbit.model_copy(update={"azimuth_deg": request.camera.orbit.azimuth_deg + azimuth_deg})
    return request.model_copy(update={"camera": OrbitCamera(orbit=orbit)})


def draw(gpu: Gpu, asset: MeshAsset, request: RenderRequest) -> float:
    """Milliseconds of a frame."""
    return render_frame(gpu, asset, request, true_times=True).ms


def choice_is_right(gpu: Gpu, asset: MeshAsset, request: RenderRequest) -> dict[str, Any]:
    """The planner's choice for a request against the best one, in their own times."""
    view = resolve_camera(request.camera, asset.frame, request.width, request.height, asset.radius)
    made = plan_frame(request, asset, view, gpu.costs).choice
    errors = {number: choice.error_px for number, choice in allowed(gpu, asset, request, view)}
    once = {number: draw(gpu, asset, with_rung(asset, request, number)) for number in errors}
    candidates = contenders(once, errors, request.accuracy) | {made.number}
    times: dict[int, list[float]] = {number: [] for number in candidates}
    for _ in range(BEST_OF):
        for number in candidates:
            times[number].append(draw(gpu, asset, with_rung(asset, request, number)))
    took = {number: statistics.median(values) for number, values in times.items()}
    best = min(candidates, key=lambda number: rank(asset, view, number, errors[number], took[number], request.accuracy))
    chosen = made.number
    names = [asset.rungs.keys[number].label for number in (chosen, best)]
    kept = promises_kept(request.accuracy, errors[chosen], took[chosen], errors[best], took[best])
    ranks = [rank(asset, view, number, errors[number], 0.0, request.accuracy) for number in (chosen, best)]
    return {
        "accuracy": request.accuracy.model_dump(include={"max_error_px", "budget_ms"}, exclude_none=True), "size": request.width,
        "chosen": names[0], "best": names[1], "chosen_ms": round(took[chosen], 3), "best_ms": round(took[best], 3),
        "right": chosen == best or (kept and took[chosen] <= CLOSE * took[best]),
        "as_accurate": ranks[0] <= ranks[1],
    }  # fmt: skip


def with_rung(asset: MeshAsset, request: RenderRequest, number: int) -> RenderRequest:
    return request.model_copy(update={"accuracy": explicit(asset.rungs, number)})


def allowed(gpu: Gpu, asset: MeshAsset, request: RenderRequest, view: View) -> list[tuple[int, Choice]]:
    """Rungs that the planner may choose from for a request, each as it would be drawn."""
    terms = ViewTerms(view.width * view.height, view.width * view.height)
    free = request.accuracy.budget_ms is not None
    least = [choose(Accuracy(hull_faces=hull.faces), asset, view, terms, gpu.costs).rung.halvings for hull in asset.rungs.hulls]
    found = []
    for number, rung in enumerate(asset.rungs.rungs):
        if rung.hull is not None and (rung.halvings < least[rung.hull] or (not free and (rung.hull, rung.halvings) != (0, least[0]))):
            continue
        found.append((number, choose(explicit(asset.rungs, number), asset, view, terms, gpu.costs)))
    return found


def rank(asset: MeshAsset, view: View, number: int, error: float, ms: float, accuracy: Accuracy) -> tuple[float, ...]:
    """What the rules put first is smallest."""
    broken = max(0.0, error - (accuracy.max_error_px or math.inf))
    over = max(0.0, ms - (accuracy.budget_ms or math.inf))
    psnr = float(asset.rungs.psnr[number, asset.rungs.nearest_size(math.sqrt(view.width * view.height))])
    return (broken, over, ms, error, -psnr) if accuracy.budget_ms is None else (broken, over, error, -psnr, ms)


def contenders(once: dict[int, float], errors: dict[int, float], accuracy: Accuracy) -> set[int]:
    """Rungs that may be the best: the fastest of those that keep the bound, and with a budget those near it, the most accurate first."""
    keeping = [number for number in once if errors[number] <= (accuracy.max_error_px or math.inf) + CERTAIN] or list(once)
    fastest = sorted(keeping, key=once.__getitem__)[:AGAIN]
    if accuracy.budget_ms is None:
        return set(fastest)
    fitting = [number for number in keeping if once[number] <= 1.3 * accuracy.budget_ms]
    return set(fastest) | set(sorted(fitting, key=lambda number: (errors[number], once[number]))[: 4 * AGAIN])


def promises_kept(accuracy: Accuracy, error: float, ms: float, best_error: float, best_ms: float) -> bool:
    """Whether a choice keeps the bound, and the budget nearly, as far as the best one does."""
    bound_kept = error <= max(accuracy.max_error_px or math.inf, best_error)
    return bound_kept and ms <= CLOSE * max(accuracy.budget_ms or math.inf, best_ms)


def planning_us(gpu: Gpu, asset: MeshAsset, random: Random) -> float:
    """Median microseconds of planning."""
    times = []
    for _ in range(PLANS):
        request = random.request(random.accuracy())
        view = resolve_camera(request.camera, asset.frame, request.width, request.height, asset.radius)
        start = time.perf_counter()
        plan_frame(request, asset, view, gpu.costs)
        times.append(time.perf_counter() - start)
    return statistics.median(times) * 1e6


def evaluate(gpu: Gpu, asset: MeshAsset, seed: int, told: Callable[[str], None] = lambda text: None) -> dict[str, Any]:
    """Everything, for one mesh."""
    random = Random(asset, seed)
    for _ in range(ROUNDS):
        for number in range(len(asset.rungs.rungs)):
            draw(gpu, asset, random.request(explicit(asset.rungs, number)))
    told("warm")
    ratios = predictions(gpu, asset, random)
    told("predicted")
    choices = [choice_is_right(gpu, asset, random.request(random.accuracy())) for _ in range(REQUESTS)]
    within = [ratio for ratio in ratios if 1.0 / (1.0 + WITHIN) <= ratio <= 1.0 + WITHIN]
    return {
        "rungs": len(asset.rungs.rungs),
        "frames": len(ratios),
        "within_25_percent": round(len(within) / len(ratios), 4),
        "ratio_p5_p50_p95": [round(float(q), 3) for q in np.quantile(ratios, [0.05, 0.5, 0.95])],
        "requests": len(choices),
        "right_choices": round(sum(choice["right"] for choice in choices) / len(choices), 4),
        "as_accurate": round(sum(choice["as_accurate"] for choice in choices) / len(choices), 4),
        "choices": choices,
        "planning_us": round(planning_us(gpu, asset, random), 1),
    }


def run(mesh: str, seed: int) -> dict[str, Any]:
    """Everything, for a mesh by name."""
    with mesh_file(mesh) as path:
        asset = prepare(path, PreprocessOptions(), every_rung=True)
    gpu, seconds = calibrated()
    try:
        found = evaluate(gpu, asset, seed, lambda text: print(f"  {text}", file=sys.stderr, flush=True))
    finally:
        gpu.release()
    return {"mesh": Path(mesh).name, "device": gpu.costs.device, "calibration_s": round(seconds, 2)} | found


def print_table(result: dict[str, Any]) -> None:
    """The quality, and the choices that were wrong."""
    print(f"{result['mesh']}: {result['rungs']} rungs, {result['device']}, calibrated in {result['calibration_s']} s")
    low, middle, high = result["ratio_p5_p50_p95"]
    print(f"  predicted / observed: {middle} ({low} to {high}), {result['within_25_percent']:.1%} of {result['frames']} within 25 %")
    print(f"  choices: {result['right_choices']:.0%} of {result['requests']} right, {result['as_accurate']:.0%} as accurate as the best")
    print(f"  planning: {result['planning_us']} us")
    for choice in result["choices"]:
        if not choice["right"]:
            told = f"{choice['chosen']} ({choice['chosen_ms']} ms) instead of {choice['best']} ({choice['best_ms']} ms)"
            print(f"  wrong: {choice['accuracy']} at {choice['size']} px: {told}")


def main() -> None:
    """The program."""
    parser = mesh_parser(__doc__ or "")
    parser.add_argument("--seed", type=int, default=1, help="of the random views and requests")
    options = parser.parse_args()
    report(lambda: run(options.mesh, options.seed), options.json, print_table)


if __name__ == "__main__":
    main()
