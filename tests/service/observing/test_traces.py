"""A trace as a collector gets it: from the upload through the queue into the stages, and of a picture."""

import uuid

import pytest

from client import Client
from client.local import LocalService
from client.shapes import write_ply
from tests import meshes, plain_http

pytest.importorskip("opentelemetry.exporter.otlp.proto.http", reason="the extra otel is not installed")
from tests.service.observing.collector import Collector

pytestmark = pytest.mark.xdist_group("traces")


@pytest.fixture(scope="module")
def seen(tmp_path_factory):
    """(process, span) of an upload that became ready and of one picture, and the ids of both requests."""
    folder = tmp_path_factory.mktemp("traced")
    write_ply(str(folder / "a.ply"), *meshes.cube(3))
    upload, picture = uuid.uuid4().hex, uuid.uuid4().hex
    with Collector() as collector:
        environment = {"SILHOUETTE_TRACE_ENDPOINT": collector.url, "SILHOUETTE_MEASURE": "0", "SILHOUETTE_WARM_KERNELS": "0"}
        with LocalService(folder, environment, ("--workers", "1")) as service, Client(service.url, timeout_s=120.0) as client:
            address = f"{service.url}/v1/meshes?name=a.ply&hull_faces=40&texels=64"
            mesh_id = plain_http.post(address, content=(folder / "a.ply").read_bytes(), headers={"X-Request-Id": upload}).json()["id"]
            client.wait(mesh_id, timeout_s=200.0)
            drawn = f"{service.url}/v1/meshes/{mesh_id}/render.png?width=40&height=40"
            plain_http.get(drawn, headers={"X-Request-Id": picture}, timeout=120.0).raise_for_status()
            assert service.stop() == 0, service.last_words()
        return collector.spans, upload, picture


def attributes(span):
    return {a.key: a.value.string_value or a.value.int_value for a in span.attributes}


def of_request(spans, request):
    (root,) = [span for process, span in spans if process == "silhouette-service" and attributes(span).get("request") == request]
    return root


def test_every_stage_of_an_upload_is_in_its_trace_under_what_enqueued_it(seen):
    spans, upload, _ = seen
    root = of_request(spans, upload)
    stages = {span.name: span for process, span in spans if process == "silhouette-worker" and span.trace_id == root.trace_id}
    assert stages.keys() == {"load", "hull", "inner", "tree", "levels", "bake", "verify"}
    assert stages["load"].parent_span_id == root.span_id
    assert {stages[name].parent_span_id for name in ("hull", "inner", "tree")} == {stages["load"].span_id}
    assert all(attributes(span)["request"] == upload for span in stages.values())


def test_a_picture_is_a_trace_with_its_steps_and_passes(seen):
    spans, _, picture = seen
    root = of_request(spans, picture)
    assert root.name == "GET /v1/meshes/{mesh_id}/render.{suffix}"
    assert attributes(root)["http.response.status_code"] == 200
    steps = {span.name: span for _, span in spans if span.trace_id == root.trace_id and span is not root}
    assert steps.keys() == {"draw", "plan", "encode"}
    assert steps["draw"].parent_span_id == root.span_id
    assert steps["plan"].parent_span_id == steps["encode"].parent_span_id == steps["draw"].span_id
    assert {"edges", "coverage", "encode"} <= {event.name for event in steps["draw"].events}
    assert steps["plan"].end_time_unix_nano <= steps["encode"].start_time_unix_nano
