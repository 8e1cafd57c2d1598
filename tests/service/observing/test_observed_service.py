"""A running service as whoever operates it sees it."""

import json
import os
import re
import signal
import time
import uuid
from pathlib import Path

import pytest
from prometheus_client.parser import text_string_to_metric_families

from client import Client
from client.errors import NotFoundError
from client.local import LocalService
from client.shapes import write_ply
from tests import meshes, plain_http


def samples(text):
    return {(one.name, *sorted(one.labels.items())): one.value for f in text_string_to_metric_families(text) for one in f.samples}


def metrics_of(service):
    return samples(plain_http.get(f"{service.url}/metrics", timeout=60.0).raise_for_status().text)


def lines(service):
    return [json.loads(line) for line in service._log.read_text().splitlines() if line.startswith("{")]


def test_an_id_that_is_given_is_kept_and_another_is_made(service):
    kept = plain_http.get(f"{service.url}/healthz", headers={"X-Request-Id": "order-17.b"})
    assert kept.headers["X-Request-Id"] == "order-17.b"
    made = {plain_http.get(f"{service.url}/healthz").headers["X-Request-Id"] for _ in range(3)}
    assert len(made) == 3 and all(re.fullmatch(r"[0-9a-f]{32}", one) for one in made)


@pytest.mark.parametrize("bad", ["", "a b", "x" * 65, 'a"b', "ä".encode(), "a{b}"])
def test_an_id_that_could_break_a_line_is_replaced(service, bad):
    answer = plain_http.get(f"{service.url}/healthz", headers=[(b"X-Request-Id", bad if isinstance(bad, bytes) else bad.encode())])
    assert re.fullmatch(r"[0-9a-f]{32}", answer.headers["X-Request-Id"])


@pytest.mark.parametrize(
    ("method", "path", "status"),
    [("GET", "/v1/meshes/nope", 404), ("GET", "/no/such/page", 404), ("POST", "/healthz", 405), ("GET", "/v1/meshes?limit=0", 422)],
)
def test_a_problem_says_which_request_it_answers(service, method, path, status):
    answer = plain_http.request(method, service.url + path, headers={"X-Request-Id": "asked"})
    assert answer.status_code == status
    assert answer.json()["request_id"] == answer.headers["X-Request-Id"] == "asked"


def test_a_refusal_of_the_guard_has_an_id_too(guarded):
    answer = plain_http.get(f"{guarded.running.url}/v1/meshes", headers={"X-Request-Id": "who"})
    assert (answer.status_code, answer.json()["request_id"], answer.headers["X-Request-Id"]) == (401, "who", "who")


def test_metrics_need_the_scope_admin_where_there_are_keys(guarded):
    with guarded.http() as anyone, guarded.http("reader") as reader, guarded.http("admin") as admin:
        assert anyone.get("/metrics").status_code == 401
        assert reader.get("/metrics").status_code == 403
        answer = admin.get("/metrics")
    assert answer.status_code == 200
    assert samples(answer.text)["silhouette_refusals_total", ("code", "missing-scope")] >= 1.0


def test_lines_of_requests_name_the_key_and_never_its_secret(guarded):
    asked = uuid.uuid4().hex
    with guarded.http("reader") as reader:
        reader.get("/v1/meshes", headers={"X-Request-Id": asked})
    (line,) = [one for one in lines(guarded.running) if one.get("request") == asked and one["logger"] == "silhouette.requests"]
    assert line["key"] in guarded.tokens["reader"]
    secret = guarded.tokens["reader"].rpartition("_")[2]
    assert secret not in guarded.running._log.read_text()


def test_a_picture_is_counted_with_its_passes_and_found_in_memory_the_second_time(service, knot):
    before = metrics_of(service)
    address = f"{service.url}/v1/meshes/{knot.id}/render.png?width=47&height=31&azimuth=12.5"
    for _ in range(2):
        plain_http.get(address, timeout=120.0).raise_for_status()
    after = metrics_of(service)

    def more(*key):
        return after.get(key, 0.0) - before.get(key, 0.0)

    route = ("route", "/v1/meshes/{mesh_id}/render.{suffix}")
    assert more("silhouette_requests_total", ("method", "GET"), route, ("status", "200")) == 2.0
    assert more("silhouette_pass_seconds_count", ("name", "encode")) == 1.0
    assert more("silhouette_pass_seconds_count", ("name", "edges")) == 1.0
    assert more("silhouette_picture_cache_misses_total") == 1.0
    assert more("silhouette_picture_cache_hits_total") == 1.0
    assert after["silhouette_cache_bytes", ("cache", "gpu")] > 0.0
    assert after["silhouette_cache_bytes", ("cache", "assets")] > 0.0
    assert after["silhouette_renderer_up",] == after["silhouette_queue_up",] == 1.0


def test_what_workers_did_is_on_the_page_of_the_service(service, knot):
    found = metrics_of(service)
    for stage in ("load", "hull", "bake", "tree", "verify"):
        assert found["silhouette_stages_started_total", ("stage", stage)] >= 1.0
        assert found["silhouette_stages_ended_total", ("outcome", "done"), ("stage", stage)] >= 1.0
        count = found["silhouette_stage_seconds_count", ("stage", stage)]
        assert found["silhouette_stage_seconds_bucket", ("le", "+Inf"), ("stage", stage)] == count >= 1.0
        assert found["silhouette_stage_seconds_sum", ("stage", stage)] > 0.0
    assert {key[1][1] for key in found if key[0] == "silhouette_jobs"} == {"silhouette", "silhouette-later", "silhouette-once"}


def test_labels_do_not_grow_with_addresses_that_nobody_knows(service):
    for number in range(5):
        plain_http.get(f"{service.url}/probe/{number}.php")
    assert not [key for key in metrics_of(service) if "probe" in str(key)]


def test_a_workers_lines_have_the_request_that_began_the_mesh(service, tmp_path):
    write_ply(str(tmp_path / "a.ply"), *meshes.cube(3))
    asked = uuid.uuid4().hex
    answer = plain_http.post(
        f"{service.url}/v1/meshes?name=a.ply&hull_faces=40&texels=64",
        content=(tmp_path / "a.ply").read_bytes(),
        headers={"X-Request-Id": asked},
    )
    with Client(service.url, timeout_s=120.0) as client:
        client.wait(answer.json()["id"], timeout_s=200.0)
    told = [one for one in lines(service) if one.get("request") == asked]
    ended = [one for one in told if one["process"] == "worker" and one["logger"] == "silhouette.jobs"]
    assert {one["stage"] for one in ended} >= {"load", "hull", "verify"}
    assert {one["mesh"] for one in ended} == {answer.json()["id"]}


def pid_of(service, program):
    """Of the child of a service that runs a program."""
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            parent = int((folder / "stat").read_text().rpartition(")")[2].split()[1])
            if parent == service.pid and program in (folder / "cmdline").read_text():
                return int(folder.name)
        except (FileNotFoundError, ProcessLookupError):
            continue
    raise AssertionError(f"no {program}")


def test_a_queue_that_hangs_makes_it_not_ready_soon_and_takes_only_its_own_metrics_and_lines_can_be_turned_off(tmp_path):
    with LocalService(tmp_path, {"SILHOUETTE_MEASURE": "0", "SILHOUETTE_LOG_REQUESTS": "0"}, ("--workers", "0")) as service:
        assert plain_http.get(f"{service.url}/readyz", timeout=30.0).status_code == 200
        server = pid_of(service, "valkey-server")
        os.kill(server, signal.SIGSTOP)
        try:
            started = time.monotonic()
            answer = plain_http.get(f"{service.url}/readyz", timeout=30.0)
            page = metrics_of(service)
            took = time.monotonic() - started
        finally:
            os.kill(server, signal.SIGCONT)
        assert answer.status_code == 503
        assert answer.json()["checks"] | {"queue": ""} == {"queue": "", "store": "ok", "renderer": "ok"}
        assert answer.json()["checks"]["queue"] != "ok"
        assert page["silhouette_queue_up",] == 0.0 and ("silhouette_renders_waiting",) in page
        assert took < 15.0
        deadline = time.monotonic() + 20.0
        while plain_http.get(f"{service.url}/readyz", timeout=30.0).status_code != 200:
            assert time.monotonic() < deadline
        assert not [one for one in lines(service) if one["logger"] == "silhouette.requests"]


def test_an_error_of_the_client_says_which_line_of_the_log_it_is_about(service, client):
    with pytest.raises(NotFoundError) as refused:
        client.info("0" * 32)
    wanted, deadline, found = refused.value.request_id, time.monotonic() + 10.0, []
    while not found and time.monotonic() < deadline:  # it is written once the answer has gone
        found = [one for one in lines(service) if one.get("request") == wanted and one["logger"] == "silhouette.requests"]
    (line,) = found
    assert (line["status"], line["code"], line["mesh"]) == (404, "not-found", "0" * 32)
