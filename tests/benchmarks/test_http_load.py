"""Load is counted as it comes back, and goes to no other machine."""

from __future__ import annotations

import itertools
import threading
import time
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import pytest

from benchmarks.http_load import closed_loop, local_address, open_loop


class Answering(BaseHTTPRequestHandler):
    protocol_version = "HTTP/1.1"

    def do_GET(self):
        time.sleep(0.02)
        if self.path == "/gone":
            self.close_connection = True
            return
        body = b"x" * 1000
        self.send_response(503 if self.path == "/busy" else 200)
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        self.wfile.write(body)

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
