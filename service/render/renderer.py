"""The one thread that draws: it makes and owns the process's GL context and takes frames from a bounded queue.

After `start` the process must not fork: a child of a process with an EGL context hangs.
"""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass

from schemas.errors import BusyError
from schemas.render import RenderRequest
from service.assets import MeshAsset
from service.costs import CostModel
from service.render.frame import RenderedImage, render_frame
from service.render.state import Gpu

__all__ = ["RenderedImage", "Renderer"]

FIRST_GUESS_S = 0.05
"""A frame's duration, before any was measured."""
LEAST_RETRY_S = 0.1


Draw = Callable[[Gpu, bool], RenderedImage]
"""Makes a picture with the GL of the renderer's thread; told whether to wait for every pass."""


@dataclass(frozen=True)
class _Job:
    future: Future[RenderedImage]
    draw: Draw


@dataclass(frozen=True)
class _Forgotten:
    asset_id: str


class Renderer:
    """Draws frames in a thread of its own, one after the other.

    queue_depth: frames that may wait. gpu_cache_mib: of meshes and maps kept in the GL. true_times: see `render_frame`.
    """

    def __init__(self, queue_depth: int = 8, gpu_cache_mib: int = 512, *, true_times: bool = False) -> None:
        self._jobs: queue.SimpleQueue[_Job | _Forgotten | None] = queue.SimpleQueue()
        self._depth, self._waiting = queue_depth, 0
        self._cache_mib = gpu_cache_mib
        self._true_times = true_times
        self._thread: threading.Thread | None = None
        self._open = False
        self._lock = threading.Lock()
        self._typical_s = FIRST_GUESS_S
        self._costs: CostModel | None = None

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

    def close(self) -> None:
        """Finish the frame under way, cancel those that wait, give the context back."""
        with self._lock:
            if not self._open or self._thread is None:
                return
            self._open = False
        while True:
            try:
                job = self._jobs.get_nowait()
            except queue.Empty:
                break
            if isinstance(job, _Job):
                job.future.cancel()
        self._jobs.put(None)
        self._thread.join()

    def submit(self, asset: MeshAsset, request: RenderRequest) -> Future[RenderedImage]:
        """Queue a frame. Its future fails with what went wrong with it; cancelled before its turn it costs nothing.

        Raises BusyError when the queue is full or the renderer is closed.
        """
        return self.submit_drawing(lambda gpu, true_times: render_frame(gpu, asset, request, true_times=true_times))

    def submit_further(self, asset: MeshAsset, request: RenderRequest) -> Future[RenderedImage]:
        """The same for a frame after one that was admitted and has been drawn: it waits for its turn behind however many wait."""
        return self.submit_drawing(lambda gpu, true_times: render_frame(gpu, asset, request, true_times=true_times), further=True)

    def submit_drawing(self, draw: Draw, *, further: bool = False) -> Future[RenderedImage]:
        """The same as `submit`, or `submit_further`, for a picture of several frames."""
        job = _Job(Future(), draw)
        with self._lock:
            if not self._open:
                raise BusyError("the renderer is not running")
            if self._waiting >= self._depth and not further:
                wait = max(LEAST_RETRY_S, self._typical_s * self._depth)
                raise BusyError("too many pictures are waiting to be drawn", retry_after_s=wait)
            self._waiting += 1
            self._jobs.put(job)
        return job.future

    def submit_once(self, asset: MeshAsset, request: RenderRequest) -> Future[RenderedImage]:
        """The same as `submit` for an asset that is not drawn again: nothing of it stays in the GL."""

        def draw(gpu: Gpu, true_times: bool) -> RenderedImage:
            try:
                return render_frame(gpu, asset, request, true_times=true_times)
            finally:
                gpu.cache.drop(asset.id)

        return self.submit_drawing(draw)

    def forget(self, asset_id: str) -> None:
        """Delete what the GL holds of an asset, once the frames that wait now are drawn; always admitted."""
        with self._lock:
            if self._open:
                self._jobs.put(_Forgotten(asset_id))

    def _draw(self, ready: Future[None]) -> None:
        try:
            gpu = Gpu(self._cache_mib)
        except Exception as error:
            ready.set_exception(error)
            return
        self._costs = gpu.costs
        ready.set_result(None)
        while (job := self._jobs.get()) is not None:
            if isinstance(job, _Forgotten):
                gpu.cache.drop(job.asset_id)
            else:
                with self._lock:
                    self._waiting -= 1
                self._serve(gpu, job)
        gpu.release()

    def _serve(self, gpu: Gpu, job: _Job) -> None:
        if not job.future.set_running_or_notify_cancel():
            return
        try:
            image = job.draw(gpu, self._true_times)
        except Exception as error:
            job.future.set_exception(error)
            return
        self._typical_s += 0.1 * (sum(ms for _, ms in image.passes) / 1e3 - self._typical_s)
        job.future.set_result(image)
