"""What is not counted but looked at when somebody asks: queues, caches, disk, and what workers counted."""

from __future__ import annotations

import logging
from collections.abc import Iterable, Iterator
from itertools import accumulate

import redis
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, HistogramMetricFamily, Metric
from prometheus_client.registry import Collector

from backend.counts import BUCKETS_S, StageCounts, queue_depths, read_counts
from schemas.errors import SilhouetteError
from service.state import Services

log = logging.getLogger("silhouette.service")


class ServiceCollector(Collector):
    """The state of a service's parts. A Redis or store that does not answer costs its own lines, and never the page."""

    def __init__(self, services: Services) -> None:
        self._services = services

    def describe(self) -> Iterable[Metric]:
        """None in advance: registering must not ask Redis."""
        return []

    def collect(self) -> Iterator[Metric]:
        """All families, as they are now."""
        yield from self._own()
        try:
            yield from _of_queues(self._services)
            yield from _of_stages(read_counts(self._services.probe))
            is_there = 1.0
        except redis.RedisError as error:
            log.warning("no metrics of the queue: %s", error)
            is_there = 0.0
        yield _gauge("silhouette_queue_up", "Whether the queue server answers", is_there)

    def _own(self) -> Iterator[Metric]:
        parts = self._services
        yield _gauge("silhouette_renderer_up", "Whether the renderer draws", float(parts.renderer.can_draw))
        yield _gauge("silhouette_renders_waiting", "Frames that wait for the renderer", parts.renderer.waiting)
        yield _counter("silhouette_gl_renewals", "GL contexts made because one failed", parts.renderer.renewals)
        yield _counter("silhouette_picture_cache_hits", "Pictures given from memory", parts.pictures.hits)
        yield _counter("silhouette_picture_cache_misses", "Pictures looked for in memory and made", parts.pictures.misses)
        held = GaugeMetricFamily("silhouette_cache_bytes", "Held by a cache", labels=["cache"])
        held.add_metric(["pictures"], parts.pictures.nbytes)
        held.add_metric(["assets"], parts.assets.nbytes)
        held.add_metric(["gpu"], parts.renderer.held_bytes)
        yield held
        try:
            yield _gauge("silhouette_store_free_bytes", "Bytes that an upload may still take here", parts.store.free_bytes())
        except (OSError, SilhouetteError) as error:
            log.warning("no metrics of the store: %s", error)


def _of_queues(parts: Services) -> Iterator[Metric]:
    jobs = GaugeMetricFamily("silhouette_jobs", "Jobs in the queues; failed: given up within job_record_s", labels=["queue", "state"])
    for name, depth in queue_depths(parts.probe, parts.queue).items():
        for state in ("waiting", "running", "failed"):
            jobs.add_metric([name, state], getattr(depth, state))
    yield jobs


def _of_stages(counts: StageCounts) -> Iterator[Metric]:
    started = CounterMetricFamily("silhouette_stages_started", "Stages that workers began", labels=["stage"])
    for stage, times in counts.started.items():
        started.add_metric([stage], times)
    ended = CounterMetricFamily("silhouette_stages_ended", "Stages that ended: done, skipped or failed", labels=["stage", "outcome"])
    for key, times in counts.ended.items():
        ended.add_metric(list(key), times)
    seconds = HistogramMetricFamily("silhouette_stage_seconds", "What stages took", labels=["stage"])
    bounds = [*(str(bound) for bound in BUCKETS_S), "+Inf"]
    for stage, inside in counts.buckets.items():
        below = [float(times) for times in accumulate(inside)]
        seconds.add_metric([stage], list(zip(bounds, below, strict=True)), counts.seconds.get(stage, 0.0))
    yield from (started, ended, seconds)


def _gauge(name: str, told: str, value: float) -> Metric:
    return GaugeMetricFamily(name, told, value=value)


def _counter(name: str, told: str, value: float) -> Metric:
    return CounterMetricFamily(name, told, value=value)
