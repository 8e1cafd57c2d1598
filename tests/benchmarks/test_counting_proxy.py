"""The proxy of the benchmark of footprints: bytes come through as they are, and requests are counted."""

import threading
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import httpx
import pytest

from benchmarks.counting_proxy import LIST, CountingProxy


class Echo(BaseHTTPRequestHandler):
    protocol_version = "HTTP/1.1"

    def do_GET(self) -> None:
        self._answer(self.path.encode())

    def do_PUT(self) -> None:
        self._answer(self.rfile.read(int(self.headers["Content-Length"])))

    def _answer(self, body: bytes) -> None:
        self.send_response(200)
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        self.wfile.write(body)

    def log_message(self, *_: object) -> None:
        pass


@pytest.fixture
def server():
    server = ThreadingHTTPServer(("127.0.0.1", 0), Echo)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    yield f"http://127.0.0.1:{server.server_port}"
    server.shutdown()
    server.server_close()


def test_bytes_pass_and_requests_are_counted_by_method(server):
    body = bytes(range(256)) * 4096
    with CountingProxy(server) as proxy, httpx.Client(base_url=proxy.url) as client:
        assert client.put("/bucket/key", content=body).content == body
        assert client.get("/bucket/key").text == "/bucket/key"
        client.get("/bucket?list-type=2&prefix=a")
        assert proxy.taken() == {"PUT": 1, "GET": 1, LIST: 1}
        client.get("/bucket/other")
        assert proxy.taken() == {"GET": 1}


def test_nothing_but_this_machine_is_asked():
    with pytest.raises(ValueError, match="only for a loopback address"):
        CountingProxy("http://192.0.2.1:9000")
