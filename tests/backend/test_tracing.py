import json
import threading
from contextvars import copy_context

import pytest
from rq.job import Job
from rq.serializers import JSONSerializer

from backend.logs import bound
from backend.tracing import add_passes, carried, open_tracing, span
from tests.backend.accepting import accept

EXTRA = "the extra otel is not installed"


@pytest.fixture
def traced():
    """(tracing, spans so far by name) of one process."""
    pytest.importorskip("opentelemetry.sdk", reason=EXTRA)
    from opentelemetry.sdk.trace.export.in_memory_span_exporter import InMemorySpanExporter

    from backend.tracing import Tracing

    exporter = InMemorySpanExporter()
    tracing = Tracing("test", exporter)

    def spans():
        tracing._provider.force_flush()
        return {one.name: one for one in exporter.get_finished_spans()}

    yield tracing, spans
    tracing.close()


@pytest.fixture
def unnamed(monkeypatch):
    for name in ("OTEL_EXPORTER_OTLP_ENDPOINT", "OTEL_EXPORTER_OTLP_TRACES_ENDPOINT"):
        monkeypatch.delenv(name, raising=False)


def test_without_a_collector_nothing_is_traced(unnamed):
    assert open_tracing("service", None) is None
    with span("draw") as made:
        add_passes(made, [("edges", 1.0)])
        assert made is None
    assert carried() == {}


def test_a_span_belongs_to_the_one_around_it_in_another_thread_too(traced):
    tracing, spans = traced

    def inner():
        with span("encode", format="png"):
            pass

    with tracing.root("GET", {}), span("draw") as drawn:
        add_passes(drawn, [("edges", 1.5), ("read", 0.25)])
        thread = threading.Thread(target=copy_context().run, args=(inner,))
        thread.start()
        thread.join()
    found = spans()
    assert found["encode"].parent.span_id == found["draw"].context.span_id
    assert found["draw"].parent.span_id == found["GET"].context.span_id
    assert [(event.name, event.attributes["ms"]) for event in found["draw"].events] == [("edges", 1.5), ("read", 0.25)]
    assert found["encode"].attributes["format"] == "png"


def test_a_trace_that_comes_from_outside_goes_on(traced):
    tracing, spans = traced
    with tracing.root("GET", {"traceparent": "00-0af7651916cd43dd8448eb211c80319c-b7ad6b7169203331-01"}):
        pass
    assert f"{spans()['GET'].context.trace_id:032x}" == "0af7651916cd43dd8448eb211c80319c"


def test_a_trace_that_is_no_trace_is_begun_anew(traced):
    tracing, spans = traced
    with tracing.root("GET", {"traceparent": "00-zzz"}):
        pass
    assert spans()["GET"].parent is None


def test_a_job_carries_the_request_and_the_trace_it_comes_from(traced, store, queue):
    tracing, spans = traced
    mesh_id = accept(store)
    with bound(request="r1"), tracing.root("POST", {}):
        queue.advance(mesh_id)
    meta = Job.fetch(f"{mesh_id}-load", connection=queue.redis, serializer=JSONSerializer).meta
    with tracing.root("load", meta):
        pass
    found = spans()
    assert meta["request"] == "r1"
    assert found["load"].parent.span_id == found["POST"].context.span_id
    assert json.dumps(meta)


def test_a_job_of_no_request_carries_nothing(store, queue):
    mesh_id = accept(store)
    queue.advance(mesh_id)
    assert Job.fetch(f"{mesh_id}-load", connection=queue.redis, serializer=JSONSerializer).meta == {}
