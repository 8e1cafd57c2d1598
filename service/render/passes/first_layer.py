"""The nearest layer of surfaces whose faces do not say which side is out.

Image Precision Silhouette Edges, section 4: every face is drawn in a colour that is its number, and the pixels are read back. Departures:
the numbers are integers in a target of their own; the picture's samples are counted, not its pixels; and a face that
no sample falls on belongs to the layer when a neighbour that is turned the same way does, while one whose samples
rounding gave it does not (`kernels.line_faces`).
"""

from __future__ import annotations

import moderngl
import numpy as np

from service.kernels.line_faces import count_samples
from service.render.passes.surface import surface_of
from service.render.state import FrameState
from service.render.targets import Kind
from service.tile import NOWHERE

TILE_PX = 2048
"""Numbers along a side of what is drawn at a time."""


def find_first_layer(frame: FrameState) -> None:
    """Make `frame.samples` (f,) i4: where in the picture each face is nearest."""
    gpu, grid = frame.gpu, frame.plan.sample_grid
    samples = np.zeros(len(frame.asset.faces), np.int32)
    program = gpu.programs.get("loops", "number")
    array = surface_of(frame).array(gpu.ctx, program)
    for tile in frame.area.split(TILE_PX // grid):
        width, height = tile.width * grid, tile.height * grid
        frame.tile = tile
        framebuffer = gpu.targets.get(width, height, kind=Kind.NUMBERS).framebuffer
        framebuffer.viewport = (0, 0, width, height)
        framebuffer.depth_mask = True
        framebuffer.use()
        gpu.ctx.enable_only(moderngl.DEPTH_TEST)
        gpu.gl.ignore_windings()
        gpu.gl.reverse_depth(True)
        gpu.gl.clear_numbers()
        gpu.programs.set(program, **frame.placement())
        gpu.gl.draw(array)
        gpu.gl.finish()
        numbers = gpu.pixel_buffer(4 * width * height)
        framebuffer.read_into(numbers, viewport=(0, 0, width, height), components=1, dtype="i4")
        count_samples(numbers.view(np.int32).reshape(height, width), samples)
    frame.tile = NOWHERE
    frame.samples = samples
