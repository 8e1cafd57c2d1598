"""Load on an HTTP service of this machine, from one process: as fast as clients can, or so many requests a second whatever comes back.

HTTP/1.1 over connections that stay open, spoken by hand: a client library would take more of the processors than the service does.
"""

from __future__ import annotations

import asyncio
import ipaddress
import itertools
import time
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from urllib.parse import urlsplit

import numpy as np

FAULTS_TOLD = 20
"""Answers that were not expected, of which it is kept what was asked."""
LONGEST_ANSWER_S = 120.0
"""After so long there was no answer."""


@dataclass(frozen=True)
class Request:
    """What one client asks for. kind: a name under which its answers are counted too. expected: statuses that are right.

    leaves_after_s: the client closes the connection then, and does not wait for the answer; that counts as none.
    """

    path: str
    kind: str = ""
    method: str = "GET"
    headers: Mapping[str, str] = field(default_factory=dict)
    body: bytes = b""
    expected: frozenset[int] = frozenset({200})
    leaves_after_s: float | None = None


@dataclass(frozen=True)
class Reply:
    """What came back. status: 0 when nothing did. retry_after_s: what the service said of when to come again, else 0."""

    status: int
    retry_after_s: float = 0.0


NO_REPLY = Reply(0)


@dataclass
class Answers:
    """What came back. ms: of each request that was answered, from when it was to be sent. statuses: how many of each; 0 is no answer.

    kinds: the same of each kind of request. faults: (status, what was asked) of the first answers that were not expected.
    """

    seconds: float = 0.0
    ms: list[float] = field(default_factory=list)
    statuses: Counter[int] = field(default_factory=Counter)
    kinds: dict[str, Answers] = field(default_factory=dict)
    unexpected: int = 0
    faults: list[tuple[int, str]] = field(default_factory=list)

    @property
    def per_second(self) -> float:
        """Answers of 200 a second."""
        return self.statuses[200] / self.seconds if self.seconds else 0.0

    @property
    def asked_per_second(self) -> float:
        """Requests a second, whatever became of them."""
        return self.statuses.total() / self.seconds if self.seconds else 0.0

    def percentile(self, part: float) -> float:
        """Milliseconds that so many per cent of the answers took at most."""
        return float(np.percentile(self.ms, part)) if self.ms else float("nan")

    def count(self, request: Request, status: int, due: float) -> None:
        """Count what came back of a request that was to be sent at `due`, a time of `perf_counter`."""
        ms = (time.perf_counter() - due) * 1e3
        kind = self.kinds.setdefault(request.kind, Answers()) if request.kind else None
        for counted in (self, kind) if kind is not None else (self,):
            counted.statuses[status] += 1
            if status:
                counted.ms.append(ms)
            if status not in request.expected:
                counted.unexpected += 1
                if len(counted.faults) < FAULTS_TOLD:
                    counted.faults.append((status, f"{request.method} {request.path}"))

    def ended(self, seconds: float) -> Answers:
        """The same, of a run that took so long."""
        for counted in (self, *self.kinds.values()):
            counted.seconds = seconds
        return self


class Connection:
    """One client's connection, opened when it is first needed and again after a fault."""

    def __init__(self, host: str, port: int) -> None:
        self._address = host, port
        self._streams: tuple[asyncio.StreamReader, asyncio.StreamWriter] | None = None

    async def send(self, request: Request) -> Reply:
        """What comes back of a request, whose body has been read; status 0 when there was no answer."""
        try:
            if self._streams is None:
                self._streams = await asyncio.open_connection(*self._address)
            reader, writer = self._streams
            writer.write(_written(request, self._address[0]))
            if request.leaves_after_s is not None:
                await asyncio.sleep(request.leaves_after_s)
                self.close()
                return NO_REPLY
            async with asyncio.timeout(LONGEST_ANSWER_S):
                status, fields = _head_of(await reader.readuntil(b"\r\n\r\n"))
                if request.method != "HEAD":
                    await reader.readexactly(int(fields.get("content-length", "0")))
        except (OSError, asyncio.IncompleteReadError):
            self.close()
            return NO_REPLY
        if fields.get("connection", "").lower() == "close":
            self.close()
        return Reply(status, float(fields.get("retry-after", "0")))

    def close(self) -> None:
        """Close it; the next request opens it again."""
        if self._streams is not None:
            self._streams[1].close()
            self._streams = None


def _written(request: Request, host: str) -> bytes:
    length = {"Content-Length": str(len(request.body))} if request.body or request.method == "POST" else {}
    fields = "".join(f"{name}: {value}\r\n" for name, value in ({"Host": host} | length | dict(request.headers)).items())
    return f"{request.method} {request.path} HTTP/1.1\r\n{fields}\r\n".encode() + request.body


def _head_of(head: bytes) -> tuple[int, dict[str, str]]:
    """Status and header fields, their names in lower case."""
    first, *lines = head.decode("latin-1").split("\r\n")
    fields = {name.lower(): value.strip() for name, _, value in (line.partition(":") for line in lines if line)}
    return int(first.split(" ", 2)[1]), fields


def local_address(url: str) -> tuple[str, int]:
    """Host and port of a URL. Raises ValueError for any that is not of this machine: nothing else is ever put under load."""
    parts = urlsplit(url)
    if parts.hostname is None or parts.port is None or not ipaddress.ip_address(parts.hostname).is_loopback:
        raise ValueError(f"load is only for a loopback address with a port, not for {url}")
    return parts.hostname, parts.port


def closed_loop(url: str, requests: Iterable[str | Request], clients: int, seconds: float) -> Answers:
    """So many clients, each asking again as soon as it is answered, for so long. A request may be a path alone.

    A client that is told to come again later does nothing until then.
    """
    return asyncio.run(_closed(local_address(url), map(_request, requests), clients, seconds))


def open_loop(url: str, requests: Iterable[str | Request], per_second: float, seconds: float, clients: int = 64) -> Answers:
    """So many requests a second at even distances, over at most `clients` connections. One that must wait for a free connection
    counts from when it was due: a slow answer slows the count of none that follow."""
    return asyncio.run(_open(local_address(url), map(_request, requests), per_second, seconds, clients))


def _request(asked: str | Request) -> Request:
    return Request(asked) if isinstance(asked, str) else asked


async def _closed(address: tuple[str, int], requests: Iterator[Request], clients: int, seconds: float) -> Answers:
    answers, start = Answers(), time.perf_counter()

    async def client() -> None:
        connection = Connection(*address)
        while (asked := time.perf_counter()) - start < seconds:
            await _ask(connection, next(requests), asked, answers)
        connection.close()

    await asyncio.gather(*(client() for _ in range(clients)))
    return answers.ended(time.perf_counter() - start)


async def _open(address: tuple[str, int], requests: Iterator[Request], per_second: float, seconds: float, clients: int) -> Answers:
    answers, start = Answers(), time.perf_counter()
    dues = itertools.takewhile(lambda due: due - start < seconds, (start + n / per_second for n in itertools.count()))

    async def client() -> None:
        connection = Connection(*address)
        for due in dues:
            request = next(requests)
            await asyncio.sleep(max(0.0, due - time.perf_counter()))
            await _ask(connection, request, due, answers)
        connection.close()

    await asyncio.gather(*(client() for _ in range(clients)))
    return answers.ended(time.perf_counter() - start)


async def _ask(connection: Connection, request: Request, due: float, answers: Answers) -> None:
    reply = await connection.send(request)
    answers.count(request, reply.status, due)
    await asyncio.sleep(reply.retry_after_s)
