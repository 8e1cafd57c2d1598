"""A picture that needs no GL, drawn in bands of rows by all cores at once (`service.kernels.hull_bands`)."""

from __future__ import annotations

import threading
import time
from functools import lru_cache
from typing import Any

import numpy as np
import numpy.typing as npt

from schemas.conventions import Array
from schemas.render import ShadingMode
from service.kernels import hull_rim, hull_shading
from service.kernels.compositing import srgb_of
from service.kernels.coverage import by_band
from service.kernels.hull_bands import PASSES, draw_bands
from service.kernels.hull_visible import PLANES, SLACK
from service.render.hull_cache import PlacedHull
from service.render.passes.light import light_of
from service.render.state import COLORS_KEPT, LINEAR_TABLE, Color, FrameState, as_words, parse_color, word_of
from service.scratch import ThreadScratch
from service.silhouette.coverage import MOST_PIECES, cover_scratch
from service.threads import cores, side_by_side
from service.tile import Tile

BANDS_A_CORE = 4
"""More balance the work better, and each costs some setting up."""
LEAST_PIXELS, MOST_PIXELS = 1 << 12, 1 << 18
"""Of a band: with fewer it takes less time than setting it up, more do not stay in a core's cache."""
BARE = -1
"""Shown in place of a surface: one colour where the mask is."""
ENCODED = srgb_of(np.linspace(0.0, 1.0, hull_shading.LEVELS))
"""(LEVELS,) u1: sRGB of each amount of linear light."""

_scratch = ThreadScratch()


def draw_in_bands(frame: FrameState) -> dict[str, float]:
    """Draw the area of a frame whose plan is on the CPU into `frame.image`; returns the milliseconds of each pass, in order.

    Passes of bands that are drawn at the same time share that time, each as many cycles as it took. Raises ValueError when a segment is
    not finite.
    """
    start = time.perf_counter()
    area, covering = frame.area, frame.mask is None
    threads = 1 if frame.gpu.crowded else cores()
    if covering:
        frame.mask = np.asarray(frame.gpu.scratch.array("mask", (frame.view.height, frame.view.width), np.uint8), np.uint8)
    rows = rows_of(area, threads)
    count, bare = -(-area.height // rows), frame.request.shading.mode is ShadingMode.MASK
    hull, rim, maps = _surface(None if bare else frame.placed)
    shading, taken = _shading(frame, maps), np.zeros(1, np.int64)
    corners = (area.x, area.y, area.x + area.width, area.y + area.height)
    segments = frame.segments if covering else _NO_SEGMENTS
    finite, starts, chosen = by_band(segments, area.y, area.y + area.height, rows)
    if not finite:
        raise ValueError("segments must be finite")
    half = hull_rim.LEAST_HALF_WIDTH + frame.beyond_px
    given = (
        taken, corners, rows, covering, (segments, starts, chosen), MOST_PIECES, hull, rim, half, frame.mask, as_words(frame.image), maps,
        shading, (frame.background is not None, LINEAR_TABLE), word_of(parse_color(frame.request.shading.color)),
    )  # fmt: skip
    sizes = (rows * (area.width + SLACK), area.width, len(hull[1]) + len(rim[0]))

    def draw() -> npt.NDArray[np.int64]:
        spent = np.zeros(len(PASSES), np.int64)
        draw_bands(*given, _band_scratch.of(*sizes), spent)
        return spent

    spent = np.add.reduce(side_by_side(draw, min(threads, count)))
    wall_ms = (time.perf_counter() - start) * 1e3
    done = [(name, cycles) for name, cycles in zip(PASSES, spent.tolist(), strict=True) if cycles]
    total = sum(cycles for _, cycles in done)
    return {name: wall_ms * cycles / total for name, cycles in done}


def rows_of(area: Tile, threads: int) -> int:
    """Rows of a band of an area that is not empty, for so many threads."""
    wanted = -(-area.height // (BANDS_A_CORE * threads)) if threads > 1 else area.height
    return max(1, min(max(wanted, LEAST_PIXELS // area.width), MOST_PIXELS // area.width, area.height))


class _BandScratch(threading.local):
    """The scratch of `draw_bands`, each thread's own; the same again while it is large enough."""

    def __init__(self) -> None:
        self._sizes = (0, 0, 0)
        self._made: tuple[Any, ...] = ()

    def of(self, pixels: int, width: int, planes: int) -> tuple[Any, ...]:
        """For bands of so many pixels, SLACK a row included, so many pixels a row, and so many faces and edges."""
        if any(asked > kept for asked, kept in zip((pixels, width, planes), self._sizes, strict=True)):
            self._sizes = (max(pixels, self._sizes[0]), max(width, self._sizes[1]), max(planes, self._sizes[2]))
            self._made = self._make(*self._sizes)
        return self._made

    def _make(self, pixels: int, width: int, planes: int) -> tuple[Any, ...]:
        lines = (
            _scratch.array("floats", (3, width), np.float32), _scratch.array("near", (4, width), np.uint32),
            _scratch.array("at", (width,), np.int32), _scratch.array("colors", (width,), np.uint32),
        )  # fmt: skip
        words = _scratch.array("words", (pixels,), np.int64)
        return cover_scratch(pixels // SLACK * SLACK), lines, words, _scratch.array("planes", (planes, PLANES), np.float64)


_band_scratch = _BandScratch()
_NO_SEGMENTS = np.empty((0, 4))
_NO_HULL = (
    np.empty((0, 4)),
    np.empty((0, 3), np.int32),
    np.empty((0, 3, 2), np.float32),
    1.0,
    np.empty(0, np.int32),
    np.empty((0, 2), np.int32),
)
_NO_RIM = (np.empty((0, 4)), np.empty((0, 4)))
_NO_MAPS = (np.zeros(1, np.uint32), np.zeros(1, np.uint32), 1, 1)


def _surface(placed: PlacedHull | None) -> tuple[tuple[Any, ...], tuple[Array, Array], tuple[Any, ...]]:
    """(hull, rim, maps) of `draw_bands`; empty ones where nothing is drawn but the mask."""
    if placed is None:
        return _NO_HULL, _NO_RIM, _NO_MAPS
    s = placed.surface
    hull = (placed.points, s.faces, s.uv, placed.sense, placed.seen, placed.rows)
    return hull, (placed.ends, placed.places), (s.normals, s.colors, *s.size)


def _shading(frame: FrameState, maps: tuple[Any, ...]) -> tuple[Any, ...]:
    """The shading of `service.kernels.hull_shading.paint`."""
    shading, turn = frame.request.shading, frame.view.normal_matrix
    shown = hull_shading.FLAT
    if shading.mode is ShadingMode.MASK:
        shown = BARE
    elif shading.mode is ShadingMode.NORMAL:
        shown = hull_shading.NORMALS
    elif shading.use_mesh_color and maps[0] is not maps[1]:
        shown = hull_shading.TINTED
    turned = _AS_IS if turn is None else turn.astype(np.float32, order="C")
    light = np.array(light_of(frame), np.float32)
    return shown, turned, light, np.float32(shading.ambient), palette(parse_color(shading.color)), ENCODED


_AS_IS = np.eye(3, dtype=np.float32)


@lru_cache(COLORS_KEPT)
def palette(color: Color) -> Array:
    """(LEVELS,) u4: the word of a surface of this sRGB colour under each amount of light, without alpha."""
    words = np.zeros((hull_shading.LEVELS, 4), np.uint8)
    words[:, :3] = srgb_of(np.linspace(0.0, 1.0, hull_shading.LEVELS)[:, None] * LINEAR_TABLE[list(color)].astype(np.float64))
    return words.view("<u4")[:, 0].copy()
