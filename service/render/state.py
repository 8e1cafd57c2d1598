"""What the passes of one frame share: the GL and its caches, the request, and what earlier passes have made."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any

import moderngl
import numpy as np

from schemas.conventions import F4, F8, I4, U1, Array
from schemas.lines import LineStyle
from schemas.render import RenderRequest
from service.assets import DrawnHull, MeshAsset
from service.camera import View
from service.costs import NOMINAL, CostModel
from service.kernels.compositing import linear_table
from service.render.context import GlContext
from service.render.deep import depth_row
from service.render.gpu_cache import GpuCache
from service.render.hull_cache import HullCache, PlacedHull
from service.render.plan import Plan
from service.render.programs import Programs
from service.render.stopping import NEVER
from service.render.targets import Target, Targets
from service.scratch import ThreadScratch
from service.silhouette.contours import Contours
from service.silhouette.extract import SilhouetteTree
from service.silhouette.levels import LevelInView
from service.silhouette.lines import VectorLines
from service.silhouette.smooth import SmoothContours
from service.tile import NOWHERE, Tile

LINEAR_TABLE = linear_table()
LEAST_STREAM = 1 << 14
"""Bytes of the smallest buffer for passing vertices."""
COLORS_KEPT = 64
NEAR_EYE = 2.0
"""Normalised units from the frame's origin: the mesh is within 1 of it, so that farther eyes see rounding by less than it is."""
Color = tuple[int, int, int]


@lru_cache(COLORS_KEPT)
def parse_color(text: str) -> Color:
    """sRGB bytes of "#rrggbb"."""
    return int(text[1:3], 16), int(text[3:5], 16), int(text[5:7], 16)


def as_words(pixels: U1) -> Array:
    """(h, w) u4 view of (h, w, 4) u1 pixels, as the compositing kernels take them."""
    return pixels.view("<u4")[:, :, 0]


@lru_cache(COLORS_KEPT)
def word_of(color: Color) -> np.uint32:
    """The word of an opaque pixel."""
    return np.array([*color, 255], np.uint8).view("<u4")[0]


class Stream:
    """Buffers that are filled anew for every draw and grow as needed."""

    def __init__(self, gl: GlContext) -> None:
        self._gl, self._ctx = gl, gl.ctx
        self._vertices: moderngl.Buffer | None = None
        self._indices: moderngl.Buffer | None = None
        self._array: moderngl.VertexArray | None = None

    def filled(self, program: moderngl.Program, data: Array, layout: str, names: Sequence[str], indices: I4 | None) -> moderngl.VertexArray:
        """The data as input of the program; it lasts until the next call."""
        known = (self._vertices, self._indices)
        self._vertices = self._holding(self._vertices, data)
        if indices is not None:
            self._indices = self._holding(self._indices, indices)
        if self._array is None or known != (self._vertices, self._indices):
            if self._array is not None:
                self._array.release()
            self._array = self._ctx.vertex_array(program, [(self._vertices, layout, *names)], self._indices)
        if indices is not None:
            self._array.vertices = indices.size
        return self._array

    def _holding(self, buffer: moderngl.Buffer | None, data: Array) -> moderngl.Buffer:
        if buffer is None or buffer.size < data.nbytes:
            if buffer is not None:
                buffer.release()
            buffer = self._ctx.buffer(reserve=max(LEAST_STREAM, 2 * data.nbytes), dynamic=True)
        self._gl.fill(buffer, data)
        return buffer

    def release(self) -> None:
        """Delete the buffers."""
        for one in (self._array, self._vertices, self._indices):
            if one is not None:
                one.release()


class Gpu:
    """The GL and everything kept between frames, in it and in memory. Belongs to the thread that makes it.

    costs: of an earlier one on this device. stop: asked between passes whether to go on. crowded: whether other pictures wait, which have
    a better use for the other cores than to share the work of one frame.
    """

    def __init__(self, cache_mib: int, costs: CostModel | None = None) -> None:
        self.gl = GlContext()
        self.ctx = self.gl.ctx
        self.programs = Programs(self.ctx)
        self.targets = Targets(self.gl)
        self.cache = GpuCache(self.gl, cache_mib)
        self.hulls = HullCache(cache_mib)
        self.scratch = ThreadScratch()
        self.costs = costs or CostModel(str(self.ctx.info["GL_RENDERER"]), NOMINAL)
        self.stop = NEVER
        self.crowded = False
        self._screens: dict[moderngl.Program, moderngl.VertexArray] = {}
        self._streams: dict[moderngl.Program, Stream] = {}
        self._pixels = np.empty(0, np.uint8)

    def pixel_buffer(self, size: int) -> U1:
        """`size` bytes to read pixels into; the same memory every time."""
        if self._pixels.size < size:
            self._pixels = np.empty(size, np.uint8)
        return self._pixels[:size]

    def screen(self, program: moderngl.Program) -> moderngl.VertexArray:
        """A program's input that has no vertices: three of them cover the target."""
        if program not in self._screens:
            self._screens[program] = self.ctx.vertex_array(program, [])
        return self._screens[program]

    def streamed(
        self, program: moderngl.Program, data: Array, layout: str, names: Sequence[str], indices: I4 | None = None
    ) -> moderngl.VertexArray:
        """Vertices, and maybe indices, for the next draw with this program; the buffers are used again."""
        if program not in self._streams:
            self._streams[program] = Stream(self.gl)
        return self._streams[program].filled(program, data, layout, names, indices)

    def release(self) -> None:
        """Delete everything and give the context back."""
        for array in self._screens.values():
            array.release()
        for stream in self._streams.values():
            stream.release()
        self.cache.release()
        self.targets.release()
        self.programs.release()
        self.gl.release()


@dataclass(frozen=True)
class Strokes:
    """Lines that look the same. corners: (n, 3) f4 x, y in image pixels and depth (`kernels.strokes`), indices: (3 k,) i4 triangles."""

    style: LineStyle
    corners: F4
    indices: I4


@dataclass
class FrameState:
    """One frame under way. background: sRGB bytes, None when transparent. area: the part of the image that can have anything
    of the mesh in it; no width or height when none can. tile: the part of the area that is being drawn.

    marked: kinds of lines that have been blended. samples: (f,) i4, how many of the picture each face has. layer: (f,) u1, faces of the
    nearest layer. back_faces: (k,) i4, faces that are drawn as lines. vector_lines: the lines of the picture, as strokes. line_ends,
    strokes: by the pass that draws them. line_place: the place of this mesh among those whose edge meshes are drawn over the same target,
    and how many they are.
    """

    gpu: Gpu
    asset: MeshAsset
    request: RenderRequest
    plan: Plan
    view: View
    background: Color | None
    image: U1 = field(default_factory=lambda: np.empty((0, 0, 4), np.uint8))
    edges: I4 = field(default_factory=lambda: np.empty((0, 2), np.int32))
    contours: Contours | None = None
    triangles: I4 = field(default_factory=lambda: np.empty((0, 3), np.int32))
    segments: F8 = field(default_factory=lambda: np.empty((0, 4)))
    smooth: SmoothContours | None = None
    mask: U1 | None = None
    area: Tile = NOWHERE
    tile: Tile = NOWHERE
    target: Target | None = None
    placed: PlacedHull | None = None
    marked: int = 0
    samples: I4 | None = None
    layer: U1 | None = None
    back_faces: I4 = field(default_factory=lambda: np.empty(0, np.int32))
    vector_lines: VectorLines | None = None
    line_ends: dict[str, I4] = field(default_factory=dict)
    strokes: dict[str, list[Strokes]] = field(default_factory=dict)
    line_place: tuple[int, int] = (0, 1)
    drawn: U1 | None = None

    @property
    def level(self) -> LevelInView | None:
        """What the outline is taken from, None for the mesh itself."""
        return self.plan.level

    @property
    def hull(self) -> DrawnHull | None:
        """The hull that is drawn; None where the mesh is."""
        return None if self.plan.hull is None else self.asset.hulls[self.plan.hull]

    @property
    def outlined(self) -> tuple[F4, SilhouetteTree | None]:
        """(positions (v, 3) f4, search tree) of the surface whose silhouette is the outline."""
        if self.level is not None:
            return self.level.level.positions, self.level.level.tree
        return self.asset.positions, self.asset.tree

    @property
    def beyond_px(self) -> float:
        """Pixels by which the outline may leave the surface that is drawn, both of which hold the mesh: that of a level or a curve."""
        reach = 0.0 if self.level is None else self.level.error_px
        if self.smooth is not None:
            reach = self.smooth.reach_px
        return min(reach, float(self.view.width + self.view.height))

    def grow_area(self) -> None:
        """Add to the area what the outline may have beyond the surface."""
        self.area = self.area.grown(math.ceil(self.beyond_px), self.view.width, self.view.height)

    @property
    def scale(self) -> int:
        """Target pixels along a side of an image pixel."""
        return self.plan.sample_grid if self.plan.antialias.value == "ssaa" else 1

    @property
    def front_face(self) -> str:
        """How the GL sees faces that are counter-clockwise from outside: rows run downwards in the target."""
        return "ccw" if self.view.mirrored else "cw"

    def use_target(self, *, color: bool, alpha: bool, depth: bool) -> moderngl.Framebuffer:
        """The tile's framebuffer, bound, with its viewport, for writing to those channels."""
        if self.target is None:
            raise RuntimeError("a pass that draws came before the target was cleared")
        framebuffer = self.target.framebuffer
        framebuffer.viewport = (0, 0, self.tile.width * self.scale, self.tile.height * self.scale)
        framebuffer.color_mask = (color, color, color, alpha)
        framebuffer.depth_mask = depth
        framebuffer.use()
        return framebuffer

    def placement(self) -> dict[str, Any]:
        """Uniforms that take positions to clip space, the tile's rectangle of the image being all of it, rows downwards.

        clip_from_object: (4, 4) f4 as bytes, column-major, of positions less the point `middle` + `middle_rest`, each three f4. That is
        the eye where it is near: differences from a near point are exact in float32, and those from it are all that counts there.
        """
        t, view = self.tile, self.view
        m = view.matrix.copy()
        if self.plan.deep:
            scale, shift = self.gpu.gl.deep_range
            m[2] = scale * depth_row(view) + shift * m[3]
        m[0] = (view.width / t.width) * m[0] + ((view.width - 2.0 * t.x) / t.width - 1.0) * m[3]
        m[1] = (-view.height / t.height) * m[1] + ((view.height - 2.0 * t.y) / t.height - 1.0) * m[3]
        middle = np.zeros(3)
        if not view.orthographic and np.linalg.norm(view.eye[:3]) < NEAR_EYE:
            middle = view.eye[:3]
        m[:, 3] += m[:, :3] @ middle
        rounded = middle.astype(np.float32)
        rest = (middle - rounded).astype(np.float32)
        return {
            "clip_from_object": m.T.astype(np.float32).tobytes(),
            "middle": tuple(rounded.tolist()),
            "middle_rest": tuple(rest.tolist()),
        }

    def pixel(self) -> tuple[float, float]:
        """Size of an image pixel in the tile's normalised device coordinates."""
        return 2.0 / self.tile.width, 2.0 / self.tile.height
