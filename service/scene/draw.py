"""A planned scene as a picture: layer by layer, the farthest first, each laid OVER the ones before in linear light."""

from __future__ import annotations

import numpy as np

from service.kernels.layers import put_over, settle
from service.render.context import NO_WORK
from service.render.frame import RenderedImage, render_view
from service.render.group import Member, render_group
from service.render.renderer import Draw
from service.render.state import LINEAR_TABLE, Gpu, as_words, parse_color, word_of
from service.scene.plan import Layer, ScenePlan
from service.tile import Tile
from service.waiting import Stopwatch


def draw_scene(gpu: Gpu, plan: ScenePlan, *, true_times: bool = False) -> RenderedImage:
    """Draw it. The times of a pass are summed over the layers; `plan` of the picture names the layers and what is in them.

    rung: those of all layers; error_px: the largest of them, None where one has none. Raises RuntimeError when the GL reports an error.
    """
    whole_clock = Stopwatch()
    size = (plan.height, plan.width)
    image = np.zeros((*size, 4), np.uint8)
    words = as_words(image)
    if plan.background != "transparent":
        words[...] = word_of(parse_color(plan.background))
    mixed, light = np.zeros(size, np.uint8), np.empty((*size, 4), np.float32)
    times: dict[str, float] = {}
    steps, drawn = [], []
    for number, layer in enumerate(plan.layers):
        picture = _draw(gpu, layer, true_times)
        clock = Stopwatch()
        a = picture.area
        put_over(as_words(picture.pixels), a.x, a.y, a.x + a.width, a.y + a.height, words, mixed, light, LINEAR_TABLE)
        for name, ms in (*picture.passes, ("over", clock.ms())):
            times[name] = times.get(name, 0.0) + ms
        steps.append(_described(number, layer, picture))
        drawn.append(picture)
    clock = Stopwatch()
    settle(words, mixed, light)
    times["settle"] = clock.ms()
    steps += [f"outside: object {index}" for index in plan.outside]
    rungs = dict.fromkeys(picture.rung for picture in drawn)
    errors = [picture.error_px for picture in drawn]
    error = None if None in errors else max((error for error in errors if error is not None), default=0.0)
    whole = Tile(0, 0, plan.width, plan.height)
    work = sum((picture.work for picture in drawn), NO_WORK)
    rung = "+".join(rungs) or "empty"
    return RenderedImage(image, tuple(times.items()), tuple(steps), rung, error, whole, ms=whole_clock.ms(), work=work)


def drawing_of(plan: ScenePlan) -> Draw:
    """The drawing of a plan as a job for the renderer."""
    return lambda gpu, true_times: draw_scene(gpu, plan, true_times=true_times)


def _draw(gpu: Gpu, layer: Layer, true_times: bool) -> RenderedImage:
    if len(layer.parts) == 1:
        part = layer.parts[0]
        return render_view(gpu, part.asset, part.request, part.view, true_times=true_times)
    members = [Member(part.asset, part.request, part.view) for part in layer.parts]
    return render_group(gpu, members, true_times=true_times)


def _described(number: int, layer: Layer, picture: RenderedImage) -> str:
    """`layer[0]: object 3 clipped/coverage (edges segments ...)`; no commas, which divide the entries of the list."""
    who = "+".join(map(str, sorted(part.index for part in layer.parts)))
    kind = "object" if len(layer.parts) == 1 else "objects"
    why = f"; together: {layer.why}" if layer.why else ""
    return f"layer[{number}]: {kind} {who} {picture.rung} ({' '.join(picture.plan)}{why})"
