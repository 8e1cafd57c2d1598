"""What one service process counts, in a registry of its own; other processes have their own pages."""

from __future__ import annotations

import re

from prometheus_client import CollectorRegistry, Counter, GCCollector, Histogram, PlatformCollector, ProcessCollector
from prometheus_client.exposition import generate_latest

from service.request_record import RequestRecord

REQUEST_BUCKETS_S = (0.001, 0.0025, 0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1.0, 2.5, 5.0, 10.0, 30.0, 60.0)
PASS_BUCKETS_S = (0.0001, 0.00025, 0.0005, 0.001, 0.0025, 0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1.0, 5.0)

METHODS = frozenset({"GET", "HEAD", "POST", "DELETE", "OPTIONS", "PUT", "PATCH"})
OTHER = "other"
"""Method of a request with one that nobody knows: labels are few whatever is sent."""

ENTRY = re.compile(r"\s*([A-Za-z0-9_.\-]+);dur=([0-9.]+)\s*")
"""Of `Server-Timing`: a pass and its milliseconds."""


class Metrics:
    """Requests, refusals and passes. `registry` takes further collectors."""

    def __init__(self) -> None:
        self.registry = CollectorRegistry(auto_describe=True)
        for collector in (ProcessCollector, PlatformCollector, GCCollector):
            collector(registry=self.registry)
        self._requests = Counter(
            "silhouette_requests", "Requests that were answered", ["method", "route", "status"], registry=self.registry
        )
        self._seconds = Histogram(
            "silhouette_request_seconds",
            "From the head of a request to the end of its answer",
            ["route"],
            buckets=REQUEST_BUCKETS_S,
            registry=self.registry,
        )
        self._refusals = Counter("silhouette_refusals", "Requests answered with a problem, by its code", ["code"], registry=self.registry)
        self._passes = Histogram(
            "silhouette_pass_seconds",
            "Passes and other steps of pictures and silhouettes, as Server-Timing has them",
            ["name"],
            buckets=PASS_BUCKETS_S,
            registry=self.registry,
        )

    def count_request(self, record: RequestRecord, method: str, status: int, seconds: float) -> None:
        """Count a request that has been answered."""
        self._requests.labels(method if method in METHODS else OTHER, record.route, str(status)).inc()
        self._seconds.labels(record.route).observe(seconds)
        if record.code is not None:
            self._refusals.labels(record.code).inc()

    def count_passes(self, passes: list[tuple[str, float]]) -> None:
        """Count passes, (name, milliseconds)."""
        for name, ms in passes:
            self._passes.labels(name).observe(ms / 1e3)

    def page(self) -> bytes:
        """Everything in Prometheus' text format 0.0.4. Blocks while collectors ask."""
        return generate_latest(self.registry)


def passes_of(server_timing: str) -> list[tuple[str, float]]:
    """(name, milliseconds) of the entries of a `Server-Timing` that have a duration."""
    return [(found[1], float(found[2])) for part in server_timing.split(",") if (found := ENTRY.fullmatch(part))]
