"""One colour and alpha a pixel from its samples."""

from __future__ import annotations

import moderngl

from schemas.render import Antialias
from service.render.state import FrameState
from service.render.targets import Target


def resolve_samples(frame: FrameState) -> None:
    """Average the target's samples in linear light into a target of one sample a pixel, which becomes the target."""
    gpu, sampled = frame.gpu, frame.target
    if sampled is None:
        return
    definitions = _definitions(frame, sampled)
    program = gpu.programs.get("screen", "resolve", definitions)
    sampled.color.use(0)
    gpu.programs.set(program, samples=0, texel=(1.0 / sampled.size[0], 1.0 / sampled.size[1]))
    frame.target = gpu.targets.get(frame.tile.width, frame.tile.height, apart=True)
    framebuffer = frame.target.framebuffer
    framebuffer.viewport = (0, 0, frame.tile.width, frame.tile.height)
    framebuffer.color_mask = (True, True, True, True)
    framebuffer.use()
    gpu.ctx.enable_only(moderngl.NOTHING)
    gpu.gl.ignore_windings()
    gpu.gl.draw(gpu.screen(program), vertices=3)


def _definitions(frame: FrameState, sampled: Target) -> frozenset[str]:
    if frame.plan.antialias is Antialias.MSAA:
        return frozenset({"MULTISAMPLED", f"SAMPLES {max(1, sampled.samples)}"})
    return frozenset({f"HALF_SCALE {frame.scale // 2}"})
