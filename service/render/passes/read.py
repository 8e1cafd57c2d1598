"""The tile's pixels in memory."""

from __future__ import annotations

from service.render.state import FrameState


def read_pixels(frame: FrameState) -> None:
    """Read the target into `frame.drawn` (h, w, 4) u1, row 0 at the top; the memory is used again by the next tile."""
    if frame.target is None:
        return
    width, height = frame.tile.width, frame.tile.height
    frame.gpu.gl.finish()
    buffer = frame.gpu.pixel_buffer(4 * width * height)
    frame.target.framebuffer.read_into(buffer, viewport=(0, 0, width, height), components=4)
    frame.drawn = buffer.reshape(height, width, 4)
