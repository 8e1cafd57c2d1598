"""The one thread that draws: it makes and owns the process's GL context and takes frames from a bounded, fair queue.

After `start` the process must not fork: a child of a process with an EGL context hangs.
"""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable
from concurrent.futures import Future
from contextvars import Context, copy_context
from dataclasses import dataclass, field, replace

import moderngl

from backend.tracing import add_passes, span
from schemas.errors import TOO_LATE, BusyError
from schemas.render import Antialias, ImageFormat, PictureRequest, RenderRequest
from schemas.scene import SceneRequest
from service.assets import MeshAsset
from service.costs import GRID, CostModel
from service.render.context import EglUnavailableError, GlFaultError
from service.render.encode import encode
from service.render.fair_queue import FairQueue, FullError
from service.render.frame import RenderedImage, render_frame
from service.render.state import Gpu
from service.render.stopping import NEVER, Stop, StoppedError

__all__ = ["RenderedImage", "Renderer"]

log = logging.getLogger("silhouette.render")

FIRST_GUESS_S = 0.05
"""A frame's duration, before any was measured."""
FIRST_GUESS_SAMPLES = 512 * 512
LEAST_FRAME_S = 0.002
PATIENCE = 10.0
"""A frame is due after so many times as long as it is thought to take: so much longer may others make it wait that are shorter."""
LARGEST_WAIT = 0.4
"""But no longer than this part of the time that a picture may take."""
MEMORY = 0.95
"""What counts of earlier frames beside the latest, for the time of a sample."""
LEAST_RETRY_S = 0.1
TRIES = 2
"""How often a frame is drawn whose GL fails, each time by a new context."""
QUICK_FORMATS, QUICK_PIXELS = (ImageFormat.PNG, ImageFormat.RAW), 1 << 17
"""Pictures that the renderer's thread may encode itself."""
GL_FAULTS = (GlFaultError, moderngl.Error)

Draw = Callable[[Gpu, bool], RenderedImage]
"""Makes a picture with the GL of the renderer's thread; told whether to wait for every pass."""


class Drawing(Future[RenderedImage]):
    """A picture to come. Cancelling it while it is drawn ends that at the next pass."""

    def __init__(self, stop: Stop) -> None:
        super().__init__()
        self.stop = stop

    def cancel(self) -> bool:
        """As any future's: True when it had not begun."""
        self.stop.ask()
        return super().cancel()


def patience_s(frame_s: float, limit_s: float) -> float:
    """How long a frame lets shorter ones pass: by what it takes itself, and less than half of the time that it has, however large it is."""
    return min(PATIENCE * frame_s, LARGEST_WAIT * limit_s)


def _is_small(request: RenderRequest) -> bool:
    """Whether a picture is encoded in less time than it takes to have another thread do so."""
    return request.format in QUICK_FORMATS and request.width * request.height <= QUICK_PIXELS


def _with_body(image: RenderedImage, request: RenderRequest) -> RenderedImage:
    start = time.perf_counter()
    body = encode(image.pixels, request.format or ImageFormat.PNG)
    ms = (time.perf_counter() - start) * 1e3
    return replace(image, body=body, passes=(*image.passes, ("encode", ms)))


@dataclass(frozen=True)
class _Job:
    future: Drawing
    draw: Draw
    samples: int
    context: Context = field(default_factory=copy_context)


@dataclass(frozen=True)
class _Forgotten:
    asset_id: str


class Renderer:
    """Draws frames in a thread of its own, one after the other.

    queue_depth: frames that may wait. gpu_cache_mib: of meshes and maps kept in the GL. true_times: see `render_frame`.
    limit_s: longest that a frame may take, its waiting included.

    renewals: GL contexts that were made because one failed. held_bytes: of meshes and maps, after the last frame.
    """

    def __init__(self, queue_depth: int = 8, gpu_cache_mib: int = 512, *, true_times: bool = False, limit_s: float = float("inf")) -> None:
        self._jobs: FairQueue[_Job | _Forgotten] = FairQueue(queue_depth)
        self._cache_mib = gpu_cache_mib
        self._true_times = true_times
        self._limit_s = limit_s
        self._thread: threading.Thread | None = None
        self._gpu: Gpu | None = None
        self._open = False
        self._lock = threading.Lock()
        self._typical_s = FIRST_GUESS_S
        self._lately = FIRST_GUESS_S, float(FIRST_GUESS_SAMPLES)  # seconds and samples of frames
        self._costs: CostModel | None = None
        self._is_lost = False
        self.renewals = 0
        self.held_bytes = 0

    def start(self) -> None:
        """Make the context and begin to draw. Raises EglUnavailableError."""
        ready: Future[None] = Future()
        self._thread = threading.Thread(target=self._draw, args=(ready,), name="renderer", daemon=True)
        self._thread.start()
        ready.result()
        self._open = True

    @property
    def costs(self) -> CostModel:
        """What frames cost here. Raises BusyError before the renderer runs."""
        if self._costs is None:
            raise BusyError("the renderer is not running")
        return self._costs

    @property
    def waiting(self) -> int:
        """Frames that wait."""
        return len(self._jobs)

    @property
    def can_draw(self) -> bool:
        """Whether its thread runs and has a GL, or has not yet failed to make one."""
        return self._open and self._thread is not None and self._thread.is_alive() and not self._is_lost

    def close(self) -> None:
        """Finish the frame under way, cancel those that wait, give the context back."""
        with self._lock:
            if not self._open or self._thread is None:
                return
            self._open = False
        for job in self._jobs.close():
            if isinstance(job, _Job):
                job.future.cancel()
        self._thread.join()

    def submit(self, asset: MeshAsset, request: RenderRequest, owner: str = "", *, encodes: bool = False) -> Future[RenderedImage]:
        """Queue a frame. Its future fails with what went wrong with it; cancelled before its turn it costs nothing, and while it is
        drawn little more.

        owner: whom it is for; owners take turns, and of each the small pictures pass large ones that have not waited long. encodes: a
        small picture comes with its `body`: to wake another thread for that takes longer. Raises BusyError when the queue is full or the
        renderer is closed.
        """
        return self.submit_drawing(_drawing(asset, request, encodes=encodes), owner, samples_of(request))

    def submit_further(self, asset: MeshAsset, request: RenderRequest, owner: str = "") -> Future[RenderedImage]:
        """The same for a frame after one that was admitted and has been drawn: it waits for its turn however many others wait."""
        return self.submit_drawing(_drawing(asset, request), owner, samples_of(request), further=True)

    def submit_once(self, asset: MeshAsset, request: RenderRequest, owner: str = "") -> Future[RenderedImage]:
        """The same as `submit` for an asset that is not drawn again: nothing of it stays in the GL."""

        def draw(gpu: Gpu, true_times: bool) -> RenderedImage:
            try:
                return render_frame(gpu, asset, request, true_times=true_times)
            finally:
                gpu.cache.drop(asset.id)

        return self.submit_drawing(draw, owner, samples_of(request))

    def submit_drawing(
        self, draw: Draw, owner: str = "", samples: int = FIRST_GUESS_SAMPLES, *, further: bool = False
    ) -> Future[RenderedImage]:
        """The same as `submit`, or `submit_further`, for a picture of several frames. samples: about how many are drawn."""
        now = time.monotonic()
        job = _Job(Drawing(Stop(now + self._limit_s)), draw, samples)
        seconds, counted = self._lately
        due = now + patience_s(LEAST_FRAME_S + seconds / counted * samples, self._limit_s)
        with self._lock:
            if not self._open:
                raise BusyError("the renderer is not running")
            try:
                dropped = self._jobs.put(owner, job, promised=further, due=due)
            except FullError:
                raise self._busy() from None
        if isinstance(dropped, _Job) and dropped.future.set_running_or_notify_cancel():
            dropped.future.set_exception(self._busy())
        return job.future

    def forget(self, asset_id: str, owner: str = "") -> None:
        """Delete what the GL holds of an asset, once the frames of this owner that wait now are drawn; always admitted."""
        with self._lock:
            if self._open:
                self._jobs.put(owner, _Forgotten(asset_id), promised=True)

    def _busy(self) -> BusyError:
        wait = max(LEAST_RETRY_S, self._typical_s * self._jobs.depth)
        return BusyError("too many pictures are waiting to be drawn", retry_after_s=wait)

    def _draw(self, ready: Future[None]) -> None:
        try:
            self._gpu = Gpu(self._cache_mib)
        except Exception as error:
            ready.set_exception(error)
            return
        self._costs = self._gpu.costs
        ready.set_result(None)
        while (job := self._jobs.take()) is not None:
            if isinstance(job, _Forgotten):
                if self._gpu is not None:
                    self._gpu.cache.drop(job.asset_id)
            elif job.future.set_running_or_notify_cancel():
                job.context.run(self._serve, job)
            if self._gpu is not None:
                self.held_bytes = self._gpu.cache.nbytes + self._gpu.hulls.nbytes
        self._give_back()

    def _serve(self, job: _Job) -> None:
        try:
            with span("draw") as traced:
                image = self._drawn(job)
                add_passes(traced, image.passes)
        except StoppedError:
            job.future.set_exception(BusyError(TOO_LATE))
        except Exception as error:
            job.future.set_exception(error)
        else:
            took_s = sum(ms for _, ms in image.passes) / 1e3
            self._typical_s += 0.1 * (took_s - self._typical_s)
            self._lately = MEMORY * self._lately[0] + took_s, MEMORY * self._lately[1] + job.samples
            job.future.set_result(image)

    def _drawn(self, job: _Job) -> RenderedImage:
        """The picture, by a new GL context when the one there was fails. Raises BusyError when that fails, too."""
        for _ in range(TRIES):
            job.future.stop.check()
            gpu = self._gpu or self._renewed()
            gpu.stop, gpu.crowded = job.future.stop, len(self._jobs) > 0
            try:
                return job.draw(gpu, self._true_times)
            except GL_FAULTS as error:
                log.exception("the GL failed, and is begun anew", exc_info=error)
                self._give_back()
            finally:
                gpu.stop = NEVER
        raise BusyError("the GL failed, and failed again")

    def _renewed(self) -> Gpu:
        """A new context. Raises BusyError when there is none to be had."""
        try:
            self._gpu = Gpu(self._cache_mib, self._costs)
        except (EglUnavailableError, *GL_FAULTS) as error:
            self._is_lost = True
            raise BusyError("the GL is gone") from error
        self._is_lost = False
        self.renewals += 1
        return self._gpu

    def _give_back(self) -> None:
        """Release the context, which may be broken."""
        gpu, self._gpu = self._gpu, None
        if gpu is not None:
            try:
                gpu.release()
            except GL_FAULTS as error:
                log.warning("a GL context was not released: %s", error)


def samples_of(request: PictureRequest | SceneRequest) -> int:
    """About how many samples a picture takes. Lines are drawn over four a pixel unless something else is asked for."""
    antialias = request.accuracy.antialias
    if antialias is Antialias.AUTO and request.lines is not None:
        antialias = Antialias.MSAA
    return request.width * request.height * GRID.get(antialias, 1) ** 2


def _drawing(asset: MeshAsset, request: RenderRequest, *, encodes: bool = False) -> Draw:
    def draw(gpu: Gpu, true_times: bool) -> RenderedImage:
        image = render_frame(gpu, asset, request, true_times=true_times)
        return _with_body(image, request) if encodes and _is_small(request) else image

    return draw
