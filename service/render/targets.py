"""Framebuffers, kept for a few sizes and reused."""

from __future__ import annotations

from collections import OrderedDict
from dataclasses import dataclass
from enum import Enum

import moderngl

from service.render.context import GlContext

SIZE_STEP = 64
"""Sides are rounded up to a multiple of this, pixels: a turning object needs few framebuffers."""
MOST_TARGETS = 8
LEAST_TARGETS = 4
"""So many are kept whatever their sizes: more than one frame draws to at a time."""
MOST_BYTES = 96 << 20
"""About what those that are kept take together: enough for eight of 1024x1024 pixels, or for one of 2048x1280 with 4 samples."""
SAMPLE_BYTES = 8
"""Of a sample, its colour and its depth."""
SRGB8_ALPHA8 = 0x8C43


class Kind(Enum):
    """What a framebuffer is for.

    PICTURE: sRGB bytes, 24 bits of depth, stencil. READABLE: the same, with a depth that shaders can read. DEEP: sRGB bytes and floats
    of depth. DEEP_MARKED: and stencil. DEEP_READABLE: the same, with a depth that shaders can read. NUMBERS: an integer a pixel, floats
    of depth.
    """

    PICTURE = "picture"
    READABLE = "picture, depth in a texture"
    DEEP = "deep"
    DEEP_MARKED = "deep, marked"
    DEEP_READABLE = "deep, marked, depth in a texture"
    NUMBERS = "numbers"


READABLE = (Kind.READABLE, Kind.DEEP_READABLE)
"""Those with depth in a texture."""


@dataclass(frozen=True)
class Target:
    """A framebuffer with colour (sRGB bytes, linear when sampled) or 32-bit integers, and a depth buffer.

    depth: its name, of a texture where it can be read. size: (width, height), pixels.
    """

    framebuffer: moderngl.Framebuffer
    color: moderngl.Texture
    depth: int
    size: tuple[int, int]
    samples: int
    kind: Kind

    @property
    def nbytes(self) -> int:
        """About what it takes in the GL: colour and depth of every sample."""
        return nbytes_of(self.size, self.samples)


def nbytes_of(size: tuple[int, int], samples: int) -> int:
    """About what a framebuffer of this size takes."""
    return size[0] * size[1] * max(samples, 1) * SAMPLE_BYTES


class Targets:
    """At most MOST_TARGETS framebuffers, and MOST_BYTES while there are more than LEAST_TARGETS; the least recently used one goes first."""

    def __init__(self, gl: GlContext) -> None:
        self._gl = gl
        self._kept: OrderedDict[tuple[int, int, int, bool, Kind], Target] = OrderedDict()
        self._over: dict[int, tuple[moderngl.Framebuffer, int]] = {}

    def __len__(self) -> int:
        return len(self._kept)

    def get(self, width: int, height: int, samples: int = 0, *, apart: bool = False, kind: Kind = Kind.PICTURE) -> Target:
        """A framebuffer of at least width x height pixels; what is in it is anything.

        apart: not the one of the same size that is given without, which may be read while this one is drawn to.
        """
        key = (-(-width // SIZE_STEP) * SIZE_STEP, -(-height // SIZE_STEP) * SIZE_STEP, samples, apart, kind)
        if key not in self._kept:
            while self._is_full(nbytes_of(key[:2], samples)):
                self._delete(self._kept.popitem(last=False)[1])
            self._kept[key] = self._make(key[:2], samples, kind)
        self._kept.move_to_end(key)
        return self._kept[key]

    @property
    def nbytes(self) -> int:
        """About what all of them take in the GL."""
        return sum(target.nbytes for target in self._kept.values())

    def _is_full(self, more: int) -> bool:
        """Whether one has to go before one of so many bytes comes."""
        count = len(self._kept)
        return count >= MOST_TARGETS or (count >= LEAST_TARGETS and self.nbytes + more > MOST_BYTES)

    def release(self) -> None:
        """Delete them all."""
        while self._kept:
            self._delete(self._kept.popitem()[1])

    def _make(self, size: tuple[int, int], samples: int, kind: Kind) -> Target:
        if kind is Kind.NUMBERS:
            color = self._gl.ctx.texture(size, 1, dtype="i4")
        else:
            color = self._gl.ctx.texture(size, 4, samples=samples, internal_format=SRGB8_ALPHA8)
        framebuffer = self._gl.ctx.framebuffer([color])
        framebuffer.depth_mask = True
        gl = self._gl
        attach = {
            Kind.PICTURE: gl.attach_depth_stencil,
            Kind.READABLE: gl.attach_depth_texture,
            Kind.DEEP_MARKED: gl.attach_float_depth_stencil,
            Kind.DEEP_READABLE: gl.attach_float_depth_texture,
        }.get(kind, gl.attach_float_depth)
        return Target(framebuffer, color, attach(framebuffer, size, samples), size, samples, kind)

    def over(self, target: Target) -> moderngl.Framebuffer:
        """For drawing over a target's colour while its depth is read from a texture: a framebuffer with a depth buffer of its own,
        with anything in it."""
        if target.depth not in self._over:
            framebuffer = self._gl.ctx.framebuffer([target.color])
            framebuffer.depth_mask = True
            own = self._gl.attach_depth_stencil(framebuffer, target.size, target.samples)
            self._over[target.depth] = framebuffer, own
        return self._over[target.depth][0]

    def _delete(self, target: Target) -> None:
        framebuffer, own = self._over.pop(target.depth, (None, 0)) if target.kind in READABLE else (None, 0)
        if framebuffer is not None:
            framebuffer.release()
            self._gl.delete_renderbuffer(own)
        target.framebuffer.release()
        target.color.release()
        delete = self._gl.delete_texture if target.kind in READABLE else self._gl.delete_renderbuffer
        delete(target.depth)
