"""Load on an HTTP service of this machine, from one process: as fast as clients can, or so many requests a second whatever comes back.

HTTP/1.1 over connections that stay open, spoken by hand: a client library would take more of the processors than the service does.
"""

from __future__ import annotations

import asyncio
import ipaddress
import itertools
import time
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from urllib.parse import urlsplit

import numpy as np


@dataclass
class Answers:
    """What came back. ms: of each request that was answered, from when it was to be sent. statuses: how many of each; 0 is no answer."""

    seconds: float = 0.0
    ms: list[float] = field(default_factory=list)
    statuses: Counter[int] = field(default_factory=Counter)

    @property
    def per_second(self) -> float:
        """Answers of 200 a second."""
        return self.statuses[200] / self.seconds if self.seconds else 0.0

    def percentile(self, part: float) -> float:
        """Milliseconds that so many per cent of the answers took at most."""
        return float(np.percentile(self.ms, part)) if self.ms else float("nan")


class Connection:
    """One client's connection, opened when it is first needed and again after a fault."""

    def __init__(self, host: str, port: int) -> None:
        self._address = host, port
        self._streams: tuple[asyncio.StreamReader, asyncio.StreamWriter] | None = None

    async def get(self, path: str) -> int:
        """Status of a GET whose body has been read; 0 when there was no answer."""
        try:
            if self._streams is None:
                self._streams = await asyncio.open_connection(*self._address)
            reader, writer = self._streams
            writer.write(f"GET {path} HTTP/1.1\r\nHost: {self._address[0]}\r\n\r\n".encode())
            head = await reader.readuntil(b"\r\n\r\n")
            status, length = _head_of(head)
            await reader.readexactly(length)
        except (OSError, asyncio.IncompleteReadError):
            self.close()
            return 0
        return status

    def close(self) -> None:
        """Close it; the next request opens it again."""
        if self._streams is not None:
            self._streams[1].close()
            self._streams = None


def _head_of(head: bytes) -> tuple[int, int]:
    lines = head.split(b"\r\n")
    status = int(lines[0].split(b" ", 2)[1])
    length = next((int(line.partition(b":")[2]) for line in lines if line.lower().startswith(b"content-length:")), 0)
    return status, length


def local_address(url: str) -> tuple[str, int]:
    """Host and port of a URL. Raises ValueError for any that is not of this machine: nothing else is ever put under load."""
    parts = urlsplit(url)
    if parts.hostname is None or parts.port is None or not ipaddress.ip_address(parts.hostname).is_loopback:
        raise ValueError(f"load is only for a loopback address with a port, not for {url}")
    return parts.hostname, parts.port


def closed_loop(url: str, paths: Iterable[str], clients: int, seconds: float) -> Answers:
    """So many clients, each asking again as soon as it is answered, for so long."""
    return asyncio.run(_closed(local_address(url), iter(paths), clients, seconds))


def open_loop(url: str, paths: Iterable[str], per_second: float, seconds: float, clients: int = 64) -> Answers:
    """So many requests a second at even distances, over at most `clients` connections. One that must wait for a free connection
    counts from when it was due: a slow answer slows the count of none that follow."""
    return asyncio.run(_open(local_address(url), iter(paths), per_second, seconds, clients))


async def _closed(address: tuple[str, int], paths: Iterator[str], clients: int, seconds: float) -> Answers:
    answers, start = Answers(), time.perf_counter()

    async def client() -> None:
        connection = Connection(*address)
        while (asked := time.perf_counter()) - start < seconds:
            _count(answers, await connection.get(next(paths)), asked)
        connection.close()

    await asyncio.gather(*(client() for _ in range(clients)))
    answers.seconds = time.perf_counter() - start
    return answers


async def _open(address: tuple[str, int], paths: Iterator[str], per_second: float, seconds: float, clients: int) -> Answers:
    answers, start = Answers(), time.perf_counter()
    dues = itertools.takewhile(lambda due: due - start < seconds, (start + n / per_second for n in itertools.count()))

    async def client() -> None:
        connection = Connection(*address)
        for due in dues:
            path = next(paths)
            await asyncio.sleep(max(0.0, due - time.perf_counter()))
            _count(answers, await connection.get(path), due)
        connection.close()

    await asyncio.gather(*(client() for _ in range(clients)))
    answers.seconds = time.perf_counter() - start
    return answers


def _count(answers: Answers, status: int, asked: float) -> None:
    answers.statuses[status] += 1
    if status:
        answers.ms.append((time.perf_counter() - asked) * 1e3)
