"""The picture that others are compared with: the original with 16 x 16 samples a pixel."""

from __future__ import annotations

import numpy as np

from schemas.conventions import F4, Array
from schemas.ladder import SAMPLES
from schemas.render import Accuracy, Antialias, AnyCamera, RenderRequest, Source
from service.assets import MeshAsset
from service.camera import resolve_camera
from service.kernels.picture_errors import reduce_samples
from service.render.frame import tiles_of
from service.render.passes.clear import clear_target
from service.render.passes.read import read_pixels
from service.render.passes.surface import draw_surface
from service.render.plan import plan_frame
from service.render.state import LINEAR_TABLE, FrameState, Gpu, as_words
from service.threads import cores, side_by_side
from service.tile import Tile


def reference(gpu: Gpu, asset: MeshAsset, camera: AnyCamera, side: int) -> F4:
    """(side, side, 4) f4 premultiplied linear: the shaded original on a transparent ground; alpha is the share of samples inside.

    Drawn tile by tile at SAMPLES times the size, and averaged as it is read. Raises RuntimeError when the GL reports an error.
    """
    large = side * SAMPLES
    request = RenderRequest(camera=camera, width=side, height=side, accuracy=Accuracy(source=Source.ORIGINAL, antialias=Antialias.NONE))
    view = resolve_camera(camera, asset.frame, large, large, asset.radius)
    plan = plan_frame(request, asset, view)
    frame = FrameState(gpu, asset, request, plan, view, None)
    out = np.zeros((side, side, 4), np.float32)
    for tile in tiles_of(plan, _on_pixels(plan.area)):
        frame.tile = tile
        clear_target(frame)
        draw_surface(frame)
        read_pixels(frame)
        if frame.drawn is not None:
            x, y, width, height = (part // SAMPLES for part in (tile.x, tile.y, tile.width, tile.height))
            _reduce(as_words(frame.drawn), out[y : y + height, x : x + width])
    gpu.gl.check()
    return out


def _reduce(words: Array, out: F4) -> None:
    """Average a tile's samples into its pixels: cores take the rows in turn."""
    rows = iter(range(len(out)))

    def work() -> None:
        for y in rows:
            reduce_samples(words[SAMPLES * y : SAMPLES * (y + 1)], SAMPLES, LINEAR_TABLE, out[y : y + 1])

    side_by_side(work, cores())


def _on_pixels(area: Tile) -> Tile:
    """The samples of all pixels that have a sample in an area of them."""
    x0, y0 = area.x // SAMPLES * SAMPLES, area.y // SAMPLES * SAMPLES
    x1, y1 = -(-(area.x + area.width) // SAMPLES) * SAMPLES, -(-(area.y + area.height) // SAMPLES) * SAMPLES
    return Tile(x0, y0, x1 - x0, y1 - y0) if area.width else area
