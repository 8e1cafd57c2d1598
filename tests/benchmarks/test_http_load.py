"""Load is counted as it comes back, and goes to no other machine."""

from __future__ import annotations

import itertools
import threading
import time
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import pytest

from benchmarks.http_load import Request, closed_loop, local_address, open_loop


class Answering(BaseHTTPRequestHandler):
    protocol_version = "HTTP/1.1"

    def do_GET(self):
        time.sleep(0.02)
        if self.path == "/gone":
            self.close_connection = True
            return
        body = b"x" * 1000
        self.send_response({"/busy": 503, "/later": 503}.get(self.path, 200))
        if self.path == "/later":
            self.send_header("Retry-After", "0.3")
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        self.wfile.write(body)

    def do_POST(self):
        sent = self.rfile.read(int(self.headers["Content-Length"]))
        self.send_response(200 if (sent, self.headers["X-Wanted"]) == (b"body", "1") else 400)
        self.send_header("Content-Length", "0")
        self.end_headers()

    def log_message(self, *_):
        pass


@pytest.fixture
def url():
    server = ThreadingHTTPServer(("127.0.0.1", 0), Answering)
    thread = threading.Thread(target=server.serve_forever)
    thread.start()
    yield f"http://127.0.0.1:{server.server_address[1]}"
    server.shutdown()
    thread.join()
    server.server_close()


def test_every_kind_of_answer_is_counted(url):
    answers = closed_loop(url, itertools.cycle(["/", "/busy", "/gone"]), clients=3, seconds=0.5)
    assert min(answers.statuses[status] for status in (200, 503, 0)) >= 2
    assert len(answers.ms) == answers.statuses[200] + answers.statuses[503]
    assert answers.percentile(0) >= 20.0
    assert answers.per_second == pytest.approx(answers.statuses[200] / answers.seconds)


def test_requests_at_even_distances_count_from_when_they_were_due(url):
    answers = open_loop(url, itertools.repeat("/"), per_second=40.0, seconds=0.5, clients=1)
    assert sum(answers.statuses.values()) == 20
    one_by_one = open_loop(url, itertools.repeat("/"), per_second=200.0, seconds=0.2, clients=1)
    assert one_by_one.percentile(100) > 3 * one_by_one.percentile(0), "what waits for the one connection is late by that"


@pytest.mark.parametrize("other", ["http://192.0.2.1:80", "http://example.com:80", "http://localhost:80", "http://127.0.0.1"])
def test_no_other_machine_is_put_under_load(other):
    with pytest.raises(ValueError, match=r"loopback|address"):
        local_address(other)


def test_requests_have_methods_headers_and_bodies_and_are_counted_by_kind(url):
    sent = Request("/", "sent", "POST", {"X-Wanted": "1"}, b"body")
    refused = Request("/", "refused", "POST", expected=frozenset({400}))
    answers = closed_loop(url, itertools.cycle([sent, refused, "/busy"]), clients=1, seconds=0.3)
    assert set(answers.kinds) == {"sent", "refused"}
    assert set(answers.kinds["sent"].statuses) == {200} and set(answers.kinds["refused"].statuses) == {400}
    assert answers.unexpected == answers.statuses[503] > 0
    assert answers.faults[0] == (503, "GET /busy")
    assert answers.asked_per_second == pytest.approx(answers.statuses.total() / answers.seconds)


def test_who_is_told_to_come_again_later_does_so(url):
    answers = closed_loop(url, itertools.repeat("/later"), clients=1, seconds=0.5)
    assert 1 <= answers.statuses[503] <= 2


def test_who_leaves_early_has_no_answer_and_comes_again(url):
    leaving = Request("/", "leaves", expected=frozenset({0}), leaves_after_s=0.001)
    answers = closed_loop(url, itertools.cycle([leaving, "/"]), clients=1, seconds=0.3)
    assert answers.kinds["leaves"].statuses.keys() == {0} and answers.unexpected == 0
    assert answers.statuses[200] >= 2
