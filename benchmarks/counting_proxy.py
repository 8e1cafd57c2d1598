"""A proxy in front of an S3 server of this machine that counts the requests that pass through it."""

from __future__ import annotations

import re
import socket
import threading
from collections import Counter
from collections.abc import Callable
from contextlib import suppress
from typing import Self

from benchmarks.http_load import local_address

REQUEST = re.compile(rb"(GET|HEAD|PUT|POST|DELETE) (/\S*) HTTP/1\.1\r\n")
CHUNK = 1 << 16
CLOSE_S = 2.0
LIST = "LIST"


class CountingProxy:
    """Passes bytes on inside `with`, on a port of its own. A request counts by its method, a listing as LIST; one whose first line comes in
    two pieces is missed."""

    def __init__(self, url: str) -> None:
        self._target = local_address(url)
        self._counts: Counter[str] = Counter()
        self._lock = threading.Lock()
        self._threads: list[threading.Thread] = []

    @property
    def url(self) -> str:
        """Where it listens."""
        return f"http://127.0.0.1:{self._listener.getsockname()[1]}"

    def __enter__(self) -> Self:
        self._listener = socket.create_server(("127.0.0.1", 0), backlog=128)
        self._threads.append(self._start(self._serve))
        return self

    def __exit__(self, *_: object) -> None:
        with suppress(OSError):
            self._listener.shutdown(socket.SHUT_RDWR)
        self._listener.close()
        for thread in self._threads:
            thread.join(CLOSE_S)

    def taken(self) -> Counter[str]:
        """Requests since the last call, by method."""
        with self._lock:
            counts, self._counts = self._counts, Counter()
        return counts

    def _start(self, call: Callable[..., None], *arguments: object) -> threading.Thread:
        thread = threading.Thread(target=call, args=arguments, name="proxy", daemon=True)
        thread.start()
        return thread

    def _serve(self) -> None:
        with suppress(OSError):
            while True:
                self._threads.append(self._start(self._connect, self._listener.accept()[0]))

    def _connect(self, client: socket.socket) -> None:
        with client, socket.create_connection(self._target) as server:
            back = self._start(self._pass_on, server, client, False)
            self._pass_on(client, server, True)
            back.join()

    def _pass_on(self, source: socket.socket, sink: socket.socket, counts: bool) -> None:
        with suppress(OSError):
            while data := source.recv(CHUNK):
                if counts:
                    self._count(data)
                sink.sendall(data)
        for end in (source, sink):
            with suppress(OSError):
                end.shutdown(socket.SHUT_RDWR)

    def _count(self, data: bytes) -> None:
        with self._lock:
            self._counts.update(LIST if b"list-type=2" in found[2] else found[1].decode() for found in REQUEST.finditer(data))
