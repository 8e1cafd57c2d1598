"""The one place that makes a GL context: headless, through EGL, with the functions that moderngl leaves out (stencil) or
calls while it holds the interpreter lock (drawing, waiting: on a software renderer the work is done inside those).

A context belongs to the thread that makes it, and a process must not fork once it has one.
"""

from __future__ import annotations

import ctypes
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import glcontext
import moderngl
import numpy as np
import numpy.typing as npt

from service.render.programs import Programs

LIBRARIES = {"libEGL.so.1": "libegl1", "libGL.so.1": "libgl1"}
"""Shared library -> the Debian package that has it."""
PACKAGES = "libegl1 libgl1 libegl-mesa0 libgl1-mesa-dri"
LEAST_VERSION = 330

FEWEST_TRIED, MOST_TRIED, TRIED_NS = 1 << 10, 1 << 24, 4_000_000
"""Triangles that timer queries are tried on, and nanoseconds that make starting and waiting short beside drawing them."""

STENCIL_CENTRE = 128
"""Cleared stencil value: the winding number zero, with room for negative ones below it."""

SPARE_UNIT = 15
"""Texture unit that no pass reads from: textures are made there, whatever a pass has bound already."""

_STENCIL_TEST = 0x0B90
_DEPTH_CLAMP = 0x864F
_STENCIL_BUFFER_BIT = 0x0400
_LESS, _EQUAL, _GEQUAL, _ALWAYS = 0x0201, 0x0202, 0x0206, 0x0207
_FRONT, _BACK = 0x0404, 0x0405
_KEEP, _INCREMENT_WRAP, _DECREMENT_WRAP = 0x1E00, 0x8507, 0x8508
_FRAMEBUFFER, _RENDERBUFFER = 0x8D40, 0x8D41
_FRAMEBUFFER_SRGB = 0x8DB9
_DEPTH24_STENCIL8, _DEPTH_STENCIL_ATTACHMENT = 0x88F0, 0x821A
_DEPTH_STENCIL, _UNSIGNED_INT_24_8, _FLOAT_32_UNSIGNED_INT_24_8_REV = 0x84F9, 0x84FA, 0x8DAD
_FRAMEBUFFER_COMPLETE = 0x8CD5
_TEXTURE_2D, _TEXTURE_2D_MULTISAMPLE, _TEXTURE0 = 0x0DE1, 0x9100, 0x84C0
_MIN_FILTER, _MAG_FILTER, _MAX_LEVEL, _NEAREST = 0x2801, 0x2800, 0x813D, 0x2600
_UNSIGNED_INT = 0x1405
_DEPTH32F, _DEPTH32F_STENCIL8, _DEPTH_ATTACHMENT = 0x8CAC, 0x8CAD, 0x8D00
_NOT_EQUAL, _REPLACE = 0x0205, 0x1E01
_LOWER_LEFT, _ZERO_TO_ONE, _NEGATIVE_ONE_TO_ONE = 0x8CA1, 0x935F, 0x935E
_COLOR, _DEPTH = 0x1800, 0x1801
_VERSION = 0x1F02
CLIP_CONTROL = "GL_ARB_clip_control"

_U, _I = ctypes.c_uint, ctypes.c_int
_SIGNATURES: dict[str, tuple[Any, ...]] = {
    "glFlush": (None,),
    "glGetString": (ctypes.c_char_p, _U),
    "glFinish": (None,),
    "glUseProgram": (None, _U),
    "glBindVertexArray": (None, _U),
    "glDrawArraysInstanced": (None, _U, _I, _I, _I),
    "glDrawElementsInstanced": (None, _U, _I, _U, ctypes.c_void_p, _I),
    "glEnable": (None, _U),
    "glDisable": (None, _U),
    "glClear": (None, _U),
    "glClearStencil": (None, _I),
    "glStencilFunc": (None, _U, _I, _U),
    "glStencilOpSeparate": (None, _U, _U, _U, _U),
    "glGenRenderbuffers": (None, _I, ctypes.POINTER(_U)),
    "glDeleteRenderbuffers": (None, _I, ctypes.POINTER(_U)),
    "glBindRenderbuffer": (None, _U, _U),
    "glRenderbufferStorageMultisample": (None, _U, _I, _U, _I, _I),
    "glBindFramebuffer": (None, _U, _U),
    "glFramebufferRenderbuffer": (None, _U, _U, _U, _U),
    "glFramebufferTexture2D": (None, _U, _U, _U, _U, _I),
    "glGenTextures": (None, _I, ctypes.POINTER(_U)),
    "glDeleteTextures": (None, _I, ctypes.POINTER(_U)),
    "glActiveTexture": (None, _U),
    "glBindTexture": (None, _U, _U),
    "glTexParameteri": (None, _U, _U, _I),
    "glTexImage2D": (None, _U, _I, _I, _I, _I, _I, _U, _U, ctypes.c_void_p),
    "glTexImage2DMultisample": (None, _U, _I, _U, _I, _I, _U),
    "glCheckFramebufferStatus": (_U, _U),
    "glClearBufferiv": (None, _U, _I, ctypes.POINTER(_I)),
    "glClearBufferfv": (None, _U, _I, ctypes.POINTER(ctypes.c_float)),
}


@dataclass(frozen=True)
class GlWork:
    """What the GL was made to do: draw calls, and bytes given to it in buffers and textures."""

    draws: int = 0
    uploaded_bytes: int = 0

    def __sub__(self, earlier: GlWork) -> GlWork:
        return GlWork(self.draws - earlier.draws, self.uploaded_bytes - earlier.uploaded_bytes)

    def __add__(self, other: GlWork) -> GlWork:
        return GlWork(self.draws + other.draws, self.uploaded_bytes + other.uploaded_bytes)


NO_WORK = GlWork()


class EglUnavailableError(RuntimeError):
    """This machine cannot draw: EGL or GL is missing or refuses a context. The message says what to install."""


class GlFaultError(RuntimeError):
    """The GL reported an error, has no memory left, or has lost its context: what it drew is not to be trusted."""


class GlContext:
    """A GL context of the calling thread. `ctx` is moderngl's; the methods are what it has no names for.

    Raises EglUnavailableError.
    """

    def __init__(self) -> None:
        _require_libraries()
        try:
            native = glcontext.get_backend_by_name("egl")(
                mode="standalone", glversion=LEAST_VERSION, libgl="libGL.so.1", libegl="libEGL.so.1"
            )
            self.ctx = moderngl.create_context(require=LEAST_VERSION, context=native)
        except Exception as error:
            raise EglUnavailableError(
                f"EGL made no OpenGL {LEAST_VERSION / 100:.1f} context ({error}); "
                f"a software renderer comes with: apt-get install {PACKAGES}"
            ) from error
        self._native = native
        self._gl: dict[str, Callable[..., Any]] = {
            name: ctypes.CFUNCTYPE(*signature)(native.load(name)) for name, signature in _SIGNATURES.items()
        }
        self._clip_control: Callable[..., Any] | None = None
        if self.ctx.version_code >= 450 or CLIP_CONTROL in self.ctx.extensions:
            self._clip_control = ctypes.CFUNCTYPE(None, _U, _U)(native.load("glClipControl"))
        # a surface nearer than the near plane is still in front of the eye
        self._gl["glEnable"](_DEPTH_CLAMP)
        self.most_samples = min(4, int(self.ctx.max_samples))
        self._draws = self._uploaded = 0
        self.has_timers = self._timers_work()

    @property
    def work(self) -> GlWork:
        """What has been done so far."""
        return GlWork(self._draws, self._uploaded)

    def buffer(self, data: bytes) -> moderngl.Buffer:
        """A buffer with these bytes."""
        self._uploaded += len(data)
        return self.ctx.buffer(data)

    def fill(self, buffer: moderngl.Buffer, data: npt.NDArray[Any]) -> None:
        """Give a buffer other contents, whatever still draws from the old ones."""
        self._uploaded += data.nbytes
        buffer.orphan()
        buffer.write(np.ascontiguousarray(data))

    def texture(
        self, size: tuple[int, int], channels: int, data: bytes, internal_format: int | None = None, dtype: str = "f1"
    ) -> moderngl.Texture:
        """A texture of rows without padding. dtype: moderngl's, f1 for bytes."""
        self._uploaded += len(data)
        if internal_format is None:
            return self.ctx.texture(size, channels, data, alignment=1, dtype=dtype)
        return self.ctx.texture(size, channels, data, alignment=1, internal_format=internal_format)

    def fill_texture(self, texture: moderngl.Texture, data: npt.NDArray[Any]) -> None:
        """Give a texture other contents, of the same size and type."""
        self._uploaded += data.nbytes
        texture.write(data.tobytes())

    def timed(self) -> moderngl.Query:
        """A query that times what the GL does inside a `with` block; its `elapsed` (ns) waits."""
        return self.ctx.query(time=True)

    def _timers_work(self) -> bool:
        """Whether timer queries count the work, tried on vertices: software renderers work on those while they are handed over, and
        their queries count filling and clearing alone (llvmpipe: 3 of the 26 ms of 100,000 faces).
        """
        # kept: moderngl binds it again whenever it has made another framebuffer
        framebuffer = self._tried = self.ctx.simple_framebuffer((1, 1))
        framebuffer.use()
        programs = Programs(self.ctx)
        screen = self.ctx.vertex_array(programs.get("screen", "opaque"), [])
        self._try_timer(screen, FEWEST_TRIED)  # compiles
        triangles = FEWEST_TRIED
        while self._try_timer(screen, triangles)[0] < TRIED_NS and triangles < MOST_TRIED:
            triangles *= 2
        tries = [self._try_timer(screen, triangles) for _ in range(3)]
        screen.release()
        programs.release()
        return 0.5 <= sorted(elapsed / taken for taken, elapsed in tries)[1] <= 1.1

    def _try_timer(self, screen: moderngl.VertexArray, triangles: int) -> tuple[int, int]:
        """Nanoseconds of drawing triangles, all but one outside the target, by the clock and by a query."""
        query = self.timed()
        self.finish()
        start = time.perf_counter_ns()
        with query:
            self.draw(screen, vertices=3 * triangles)
        self.finish()
        return time.perf_counter_ns() - start, int(query.elapsed)

    def release(self) -> None:
        """Give the context back; nothing made in it may be used afterwards."""
        self._tried.release()
        self.ctx.release()

    def check(self) -> None:
        """Raise GlFaultError when GL has recorded an error or is gone, so that no broken picture is handed out as done."""
        error = self.ctx.error
        if error != "GL_NO_ERROR":
            raise GlFaultError(f"the GL reported {error}")
        if self._gl["glGetString"](_VERSION) is None:  # what is asked of no context answers nothing, and records no error
            raise GlFaultError("the GL context is lost")

    def flush(self) -> None:
        """Let the GL begin with what it was given, without waiting for it."""
        self._gl["glFlush"]()

    def finish(self) -> None:
        """Wait until the GL has done everything."""
        self._gl["glFinish"]()

    def draw(self, array: moderngl.VertexArray, mode: int = moderngl.TRIANGLES, *, vertices: int | None = None, instances: int = 1) -> None:
        """What `array.render` does. A software renderer works inside these calls, and moderngl holds the interpreter lock there."""
        self._draws += 1
        count = array.vertices if vertices is None else vertices
        self._gl["glUseProgram"](array.program.glo)
        self._gl["glBindVertexArray"](array.glo)
        if array.index_buffer is not None:
            self._gl["glDrawElementsInstanced"](mode, count, _UNSIGNED_INT, None, instances)
        else:
            self._gl["glDrawArraysInstanced"](mode, 0, count, instances)

    def attach_depth_stencil(self, framebuffer: moderngl.Framebuffer, size: tuple[int, int], samples: int) -> int:
        """Give a framebuffer a depth and stencil buffer, 24 + 8 bits; the name to delete it by."""
        return self._attach(framebuffer, size, samples, _DEPTH24_STENCIL8, _DEPTH_STENCIL_ATTACHMENT)

    def _attach(self, framebuffer: moderngl.Framebuffer, size: tuple[int, int], samples: int, layout: int, place: int) -> int:
        name = _U()
        self._gl["glGenRenderbuffers"](1, ctypes.byref(name))
        self._gl["glBindRenderbuffer"](_RENDERBUFFER, name)
        self._gl["glRenderbufferStorageMultisample"](_RENDERBUFFER, samples, layout, *size)
        self._gl["glBindFramebuffer"](_FRAMEBUFFER, framebuffer.glo)
        self._gl["glFramebufferRenderbuffer"](_FRAMEBUFFER, place, _RENDERBUFFER, name)
        self._require_complete(size, samples, lambda: self.delete_renderbuffer(name.value))
        return name.value

    def attach_depth_texture(self, framebuffer: moderngl.Framebuffer, size: tuple[int, int], samples: int) -> int:
        """The same as a texture, which a shader can read its depth from; the name to use and to delete it by."""
        return self._attach_texture(framebuffer, size, samples, (_DEPTH24_STENCIL8, _UNSIGNED_INT_24_8))

    def attach_float_depth_texture(self, framebuffer: moderngl.Framebuffer, size: tuple[int, int], samples: int) -> int:
        """The same with 32-bit floats of depth."""
        return self._attach_texture(framebuffer, size, samples, (_DEPTH32F_STENCIL8, _FLOAT_32_UNSIGNED_INT_24_8_REV))

    def _attach_texture(self, framebuffer: moderngl.Framebuffer, size: tuple[int, int], samples: int, layout: tuple[int, int]) -> int:
        name = _U()
        self._gl["glGenTextures"](1, ctypes.byref(name))
        kind = _TEXTURE_2D_MULTISAMPLE if samples else _TEXTURE_2D
        self._gl["glActiveTexture"](_TEXTURE0 + SPARE_UNIT)
        self._gl["glBindTexture"](kind, name)
        if samples:
            self._gl["glTexImage2DMultisample"](kind, samples, layout[0], *size, 1)
        else:
            self._gl["glTexImage2D"](kind, 0, layout[0], *size, 0, _DEPTH_STENCIL, layout[1], None)
            for parameter, value in ((_MIN_FILTER, _NEAREST), (_MAG_FILTER, _NEAREST), (_MAX_LEVEL, 0)):
                self._gl["glTexParameteri"](kind, parameter, value)
        self._gl["glBindFramebuffer"](_FRAMEBUFFER, framebuffer.glo)
        self._gl["glFramebufferTexture2D"](_FRAMEBUFFER, _DEPTH_STENCIL_ATTACHMENT, kind, name, 0)
        self._require_complete(size, samples, lambda: self.delete_texture(name.value))
        return name.value

    def use_depth_texture(self, name: int, samples: int, unit: int) -> None:
        """Let a texture made by `attach_depth_texture` be read from a texture unit."""
        self._gl["glActiveTexture"](_TEXTURE0 + unit)
        self._gl["glBindTexture"](_TEXTURE_2D_MULTISAMPLE if samples else _TEXTURE_2D, name)

    def delete_texture(self, name: int) -> None:
        """Delete what `attach_depth_texture` made."""
        self._gl["glDeleteTextures"](1, ctypes.byref(_U(name)))

    def _require_complete(self, size: tuple[int, int], samples: int, undo: Callable[[], None]) -> None:
        status = self._gl["glCheckFramebufferStatus"](_FRAMEBUFFER)
        if status != _FRAMEBUFFER_COMPLETE:
            undo()
            raise GlFaultError(f"a framebuffer of {size[0]} x {size[1]} with {samples} samples is not complete (0x{status:x})")

    def blend_in_linear_light(self, on: bool) -> None:
        """Whether shaders give linear light to sRGB targets, and blending works on it; otherwise both are of sRGB bytes."""
        self._gl["glEnable" if on else "glDisable"](_FRAMEBUFFER_SRGB)

    def attach_float_depth(self, framebuffer: moderngl.Framebuffer, size: tuple[int, int], samples: int) -> int:
        """Give a framebuffer a depth buffer of 32-bit floats and no stencil; the name to delete it by."""
        return self._attach(framebuffer, size, samples, _DEPTH32F, _DEPTH_ATTACHMENT)

    def attach_float_depth_stencil(self, framebuffer: moderngl.Framebuffer, size: tuple[int, int], samples: int) -> int:
        """The same with a stencil of 8 bits."""
        return self._attach(framebuffer, size, samples, _DEPTH32F_STENCIL8, _DEPTH_STENCIL_ATTACHMENT)

    def delete_renderbuffer(self, name: int) -> None:
        """Delete what `attach_depth_stencil` made."""
        self._gl["glDeleteRenderbuffers"](1, ctypes.byref(_U(name)))

    @property
    def deep_range(self) -> tuple[float, float]:
        """(scale, shift) from a depth that is 1 at the eye and falls to 0 to the clip coordinate it has while depth is reversed."""
        return (2.0, -1.0) if self._clip_control is None else (1.0, 0.0)

    def reverse_depth(self, reversed_: bool) -> None:
        """From now on the larger depth is the nearer one, and floats near 0 keep apart what is far; or the smaller one, as usual.

        Without clip control depths still are from -1 to 1 before they are stored, which costs the far ones their bits.
        """
        if self._clip_control is not None:
            self._clip_control(_LOWER_LEFT, _ZERO_TO_ONE if reversed_ else _NEGATIVE_ONE_TO_ONE)
        self.ctx.depth_func = ">" if reversed_ else "<"

    def clear_numbers(self) -> None:
        """Clear the bound framebuffer of integers to zero, and its reversed depth."""
        self._gl["glClearBufferiv"](_COLOR, 0, (_I * 4)(0, 0, 0, 0))
        self._gl["glClearBufferfv"](_DEPTH, 0, ctypes.byref(ctypes.c_float(0.0)))

    def count_windings(self) -> None:
        """Clear the stencil to zero windings; from now on front faces add one and back faces take one away."""
        self._gl["glClearStencil"](STENCIL_CENTRE)
        self._gl["glClear"](_STENCIL_BUFFER_BIT)
        self._gl["glEnable"](_STENCIL_TEST)
        self._gl["glStencilFunc"](_ALWAYS, 0, 0xFF)
        self._gl["glStencilOpSeparate"](_FRONT, _KEEP, _KEEP, _INCREMENT_WRAP)
        self._gl["glStencilOpSeparate"](_BACK, _KEEP, _KEEP, _DECREMENT_WRAP)

    def keep_positive_windings(self) -> None:
        """From now on draw only where the winding number is positive."""
        self._keep_windings(_LESS, STENCIL_CENTRE)

    def keep_no_windings(self) -> None:
        """From now on draw only where the winding number is zero, or rounding made it negative."""
        self._keep_windings(_GEQUAL, STENCIL_CENTRE)

    def keep_single_windings(self) -> None:
        """From now on draw only where the winding number is one."""
        self._keep_windings(_EQUAL, STENCIL_CENTRE + 1)

    def _keep_windings(self, function: int, value: int) -> None:
        """Draw where the comparison of a value with the stencil's holds."""
        self._gl["glEnable"](_STENCIL_TEST)
        self._gl["glStencilFunc"](function, value, 0xFF)
        self._gl["glStencilOpSeparate"](_FRONT, _KEEP, _KEEP, _KEEP)
        self._gl["glStencilOpSeparate"](_BACK, _KEEP, _KEEP, _KEEP)

    def clear_marks(self) -> None:
        """Clear the stencil of the bound framebuffer to zero."""
        self._gl["glClearStencil"](0)
        self._gl["glClear"](_STENCIL_BUFFER_BIT)

    def mark_once(self, number: int) -> None:
        """From now on draw each sample once, however often it is drawn to with this number (1 to 255)."""
        self._gl["glEnable"](_STENCIL_TEST)
        self._gl["glStencilFunc"](_NOT_EQUAL, number, 0xFF)
        self._gl["glStencilOpSeparate"](_FRONT, _KEEP, _KEEP, _REPLACE)
        self._gl["glStencilOpSeparate"](_BACK, _KEEP, _KEEP, _REPLACE)

    def ignore_windings(self) -> None:
        """Draw everywhere again."""
        self._gl["glDisable"](_STENCIL_TEST)


def _require_libraries() -> None:
    for library, package in LIBRARIES.items():
        try:
            ctypes.CDLL(library)
        except OSError as error:
            raise EglUnavailableError(f"{library} is missing: apt-get install {package} (all that is needed: {PACKAGES})") from error
