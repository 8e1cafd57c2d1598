from prometheus_client.parser import text_string_to_metric_families

from service.observing.metrics import Metrics, passes_of
from service.request_record import RequestRecord


def samples(metrics):
    families = text_string_to_metric_families(metrics.page().decode())
    return {(one.name, *sorted(one.labels.items())): one.value for family in families for one in family.samples}


def test_server_timing_is_read_as_it_is_written():
    assert passes_of("edges;dur=0.054, read;dur=12.000, encode;dur=1") == [("edges", 0.054), ("read", 12.0), ("encode", 1.0)]


def test_entries_without_a_duration_are_no_passes():
    assert passes_of('cache;desc=hit, frames;desc="12"') == []
    assert passes_of("") == []


def test_a_request_is_counted_by_its_template_and_a_problem_by_its_code():
    metrics = Metrics()
    metrics.count_request(RequestRecord("a", "/v1/meshes/{mesh_id}"), "GET", 200, 0.02)
    metrics.count_request(RequestRecord("b", "/v1/meshes/{mesh_id}", code="busy"), "GET", 503, 0.3)
    found = samples(metrics)
    route = ("route", "/v1/meshes/{mesh_id}")
    assert found["silhouette_requests_total", ("method", "GET"), route, ("status", "200")] == 1.0
    assert found["silhouette_requests_total", ("method", "GET"), route, ("status", "503")] == 1.0
    assert found["silhouette_request_seconds_count", route] == 2.0
    assert found["silhouette_request_seconds_bucket", ("le", "0.025"), route] == 1.0
    assert found["silhouette_refusals_total", ("code", "busy")] == 1.0


def test_passes_are_in_seconds():
    metrics = Metrics()
    metrics.count_passes([("edges", 2.0), ("edges", 4.0)])
    assert samples(metrics)["silhouette_pass_seconds_sum", ("name", "edges")] == 0.006


def test_methods_that_nobody_knows_share_a_label():
    metrics = Metrics()
    for method in ("BREW", "WHEN"):
        metrics.count_request(RequestRecord("a"), method, 405, 0.001)
    assert samples(metrics)["silhouette_requests_total", ("method", "other"), ("route", "unmatched"), ("status", "405")] == 2.0


def test_two_applications_count_apart():
    first, second = Metrics(), Metrics()
    first.count_passes([("edges", 1.0)])
    assert ("silhouette_pass_seconds_count", ("name", "edges")) not in samples(second)
