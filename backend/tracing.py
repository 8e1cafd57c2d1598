"""OpenTelemetry traces: from a request through the queue into the stages of its mesh.

Only where a collector is named and the extra `otel` is installed; elsewhere every call here is next to nothing. What makes spans is
held in a context variable: it goes where the work goes, and nothing is global.
"""

from __future__ import annotations

import logging
import os
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Any

from backend.logs import bound_values

log = logging.getLogger(__name__)

REQUEST = "request"
"""Under which the id of a request is bound in log lines, and goes along with jobs."""

ENDPOINT_VARIABLES = ("OTEL_EXPORTER_OTLP_TRACES_ENDPOINT", "OTEL_EXPORTER_OTLP_ENDPOINT")
"""By which OpenTelemetry itself names a collector; its other variables work, too."""

EXPORT_S = 2.0
"""A collector that does not answer holds up the end of a process, or of a stage, for no longer."""

_TRACER: ContextVar[Any] = ContextVar("tracer", default=None)


class Tracing:
    """Makes the spans of one process and sends them on in the background. exporter: an OpenTelemetry span exporter."""

    def __init__(self, process: str, exporter: Any) -> None:
        from opentelemetry.sdk.resources import Resource
        from opentelemetry.sdk.trace import TracerProvider
        from opentelemetry.sdk.trace.export import BatchSpanProcessor

        self._provider = TracerProvider(resource=Resource.create({"service.name": f"silhouette-{process}"}), shutdown_on_exit=False)
        self._provider.add_span_processor(BatchSpanProcessor(exporter))

    @contextmanager
    def root(self, name: str, came_with: Mapping[str, str], **attributes: str) -> Iterator[Any]:
        """A span of what came from outside, with its `traceparent` (W3C Trace Context) if it had one; `span` works inside the block."""
        from opentelemetry.trace.propagation.tracecontext import TraceContextTextMapPropagator

        tracer = self._provider.get_tracer("silhouette")
        token = _TRACER.set(tracer)
        try:
            parent = TraceContextTextMapPropagator().extract(came_with)
            with tracer.start_as_current_span(name, context=parent, attributes=attributes) as made:
                yield made
        finally:
            _TRACER.reset(token)

    def close(self) -> None:
        """Send what is left. Blocks, for seconds at most."""
        self._provider.force_flush(int(EXPORT_S * 1e3))
        self._provider.shutdown()


def open_tracing(process: str, endpoint: str | None) -> Tracing | None:
    """Traces of this process to a collector, `endpoint` or what OpenTelemetry's own variables name; None where none is named."""
    if endpoint is None and not any(os.environ.get(name) for name in ENDPOINT_VARIABLES):
        return None
    try:
        from opentelemetry.exporter.otlp.proto.http.trace_exporter import OTLPSpanExporter
    except ImportError:
        log.warning("no traces: a collector is named, but the extra is not installed: pip install 'silhouette-service[otel]'")
        return None
    address = None if endpoint is None else f"{endpoint.rstrip('/')}/v1/traces"
    return Tracing(process, OTLPSpanExporter(address, timeout=EXPORT_S))


@contextmanager
def span(name: str, **attributes: str | int | float) -> Iterator[Any]:
    """A part of what is traced here, from beginning to end of the block; the span, or None where nothing is traced."""
    tracer = _TRACER.get()
    if tracer is None:
        yield None
        return
    with tracer.start_as_current_span(name, attributes=attributes) as made:
        yield made


def add_passes(made: Any, passes: Iterable[tuple[str, float]]) -> None:
    """Tell a span which passes there were, (name, milliseconds), as events; nothing where it is None."""
    if made is not None:
        for name, ms in passes:
            made.add_event(name, {"ms": ms})


def carried() -> dict[str, str]:
    """What a job takes along to the worker: the id of the request it comes from, and the trace."""
    found = {REQUEST: bound_values()[REQUEST]} if REQUEST in bound_values() else {}
    if _TRACER.get() is not None:
        from opentelemetry.trace.propagation.tracecontext import TraceContextTextMapPropagator

        TraceContextTextMapPropagator().inject(found)
    return found
