"""Sequences of pictures of one mesh: frame by frame through the renderer, so that other requests have their turns between.

At any time one frame of a sequence waits for the renderer. Meanwhile the positions of the next one are made ready, and those before are
encoded. What the renderer keeps of a moving mesh goes with the sequence, however it ends.
"""

from __future__ import annotations

from collections import deque
from concurrent.futures import Future
from dataclasses import dataclass, field
from functools import partial

from fastapi import Request

from schemas.conventions import U1, Array
from schemas.errors import InvalidRequestError
from schemas.render import ImageFormat
from schemas.sequence import MOST_FRAMES, MOST_PIXELS, USUAL_FRAMES, SequenceFormat, SequenceRequest
from service.assets import MeshAsset
from service.moving import FIELD, Moving
from service.owners import owner_of
from service.render.encode import encode
from service.render.renderer import RenderedImage
from service.state import Services
from service.waiting import Stopwatch, admitted, wait_for

ENCODINGS = {SequenceFormat.WEBP: ImageFormat.WEBP, SequenceFormat.APNG: ImageFormat.PNG, SequenceFormat.ZIP: ImageFormat.PNG}
"""What each frame of a sequence is."""
ENCODED_BESIDE = 2
"""Frames that may be in the making as files while the next one is drawn."""


@dataclass
class Drawn:
    """What has been drawn of a sequence. pictures: encoded. ms: of each pass, all frames together. last: the latest frame."""

    pictures: list[bytes] = field(default_factory=list)
    ms: dict[str, float] = field(default_factory=dict)
    rungs: dict[str, None] = field(default_factory=dict)
    errors_px: list[float | None] = field(default_factory=list)
    last: RenderedImage | None = None

    def add(self, image: RenderedImage) -> None:
        """Count a frame."""
        for name, ms in image.passes:
            self.took(name, ms)
        self.rungs[image.rung] = None
        self.errors_px.append(image.error_px)
        self.last = image

    def took(self, name: str, ms: float) -> None:
        """Count a step."""
        self.ms[name] = self.ms.get(name, 0.0) + ms

    @property
    def summed(self) -> RenderedImage:
        """One image that says what all frames took, in what ways, and the largest error of them."""
        assert self.last is not None
        known = [error for error in self.errors_px if error is not None]
        error = max(known) if len(known) == len(self.errors_px) else None
        passes = tuple((name, ms) for name, ms in self.ms.items())
        return RenderedImage(self.last.pixels, passes, tuple(self.ms), "+".join(self.rungs), error, self.last.area)


def frame_count(wanted: SequenceRequest, poses: int | None) -> int:
    """How many frames there are. poses: of positions, None without any.

    Raises InvalidRequestError where numbers do not go together, nothing changes from frame to frame, or it is too much.
    """
    cameras = len(wanted.cameras) if wanted.cameras is not None else None
    if wanted.turn is not None:
        cameras = wanted.turn.frames or (poses if poses not in (None, 1) else USUAL_FRAMES)
    named = "cameras" if wanted.cameras is not None else "turn.frames" if wanted.turn is not None else FIELD
    if cameras is None and poses is None:
        raise InvalidRequestError("nothing says what changes from frame to frame: turn, cameras or positions", field="turn")
    count = cameras or poses or 0
    if poses not in (None, 1, count):
        raise InvalidRequestError(f"there are {count:,} views and positions of {poses:,} frames: as many, or of one", field=named)
    if count > MOST_FRAMES:
        raise InvalidRequestError(f"a sequence has at most {MOST_FRAMES:,} frames, not {count:,}", field=named)
    pixels = count * wanted.width * wanted.height
    if pixels > MOST_PIXELS:
        said = f"{count:,} frames of {wanted.width} x {wanted.height} are {pixels:,} pixels"
        raise InvalidRequestError(f"{said}; a sequence has at most {MOST_PIXELS:,}", field=named)
    return count


class Drawing:
    """A sequence under way. poses: (k, v, 3) model units, one or as many as frames; None for a mesh that stays as it is.

    `frames` raises what a frame raises, BusyError and ClientDisconnect.
    """

    def __init__(self, request: Request, parts: Services, asset: MeshAsset, wanted: SequenceRequest, poses: Array | None) -> None:
        self._request, self._parts, self._asset, self._wanted, self._poses = request, parts, asset, wanted, poses
        self._limit_s = parts.settings.render_timeout_s
        self._count = frame_count(wanted, None if poses is None else len(poses))
        self._drawn = Drawn()

    async def frames(self, form: SequenceFormat) -> Drawn:
        """All frames, encoded for that form."""
        moving = None if self._poses is None else Moving(self._asset)
        try:
            await self._draw(moving, ENCODINGS[form])
        finally:
            if moving is not None:
                self._parts.renderer.forget(moving.id, owner_of(self._request))
        return self._drawn

    async def _draw(self, moving: Moving | None, encoding: ImageFormat) -> None:
        asset, encoded = self._asset, deque[Future[tuple[bytes, float]]]()
        posed = await self._posed(moving, 0)
        for number in range(self._count):
            if posed is not None:
                asset, ms = await wait_for(self._request, posed, self._limit_s)
                self._drawn.took("pose", ms)
            posed = await self._posed(moving, number + 1)
            image = await self._image(asset, number)
            self._drawn.add(image)
            encoded.append(await admitted(partial(self._parts.cpu.submit, _encoded, image.pixels, encoding), self._limit_s))
            if len(encoded) > ENCODED_BESIDE:
                await self._take(encoded)
        while encoded:
            await self._take(encoded)

    async def _posed(self, moving: Moving | None, number: int) -> Future[tuple[MeshAsset, float]] | None:
        """The mesh of a frame in the making, where it is another one than in the frame before."""
        if moving is None or self._poses is None or number >= len(self._poses):
            return None
        return await admitted(partial(self._parts.cpu.submit, _moved, moving, self._poses[number], number), self._limit_s)

    async def _image(self, asset: MeshAsset, number: int) -> RenderedImage:
        """A frame. That the renderer has no room is an answer to the first one only."""
        submit = self._parts.renderer.submit_further if number else self._parts.renderer.submit
        drawing = submit(asset, self._wanted.picture(number, self._count), owner_of(self._request))
        return await wait_for(self._request, drawing, self._limit_s)

    async def _take(self, encoded: deque[Future[tuple[bytes, float]]]) -> None:
        picture, ms = await wait_for(self._request, encoded.popleft(), self._limit_s)
        self._drawn.pictures.append(picture)
        self._drawn.took("encode", ms)


def _moved(moving: Moving, pose: Array, number: int) -> tuple[MeshAsset, float]:
    """The mesh in a pose, and the milliseconds it took; what is wrong with it says of which frame it is."""
    clock = Stopwatch()
    try:
        return moving.at(pose), clock.ms()
    except InvalidRequestError as error:
        error.message, error.where["frame"] = f"frame {number}: {error.message}", number
        raise


def _encoded(pixels: U1, encoding: ImageFormat) -> tuple[bytes, float]:
    clock = Stopwatch()
    return encode(pixels, encoding), clock.ms()
