"""Connections to the Redis of the queue."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import redis
from redis.backoff import ConstantBackoff
from redis.retry import Retry

SOCKET_TIMEOUT_S = 15.0  # longer than a worker's blocking wait for a job


def connect(
    url: str, password_file: Path | None = None, ca_file: Path | None = None, *, timeout_s: float = SOCKET_TIMEOUT_S
) -> redis.Redis:
    """A connection pool for `redis://`, `rediss://` or `unix://`. One quick second try, then errors are the caller's.

    password_file: its first line is the password. ca_file: certificates that the server's is to be signed by, instead of the system's.
    timeout_s: longest that one answer is waited for.
    """
    retry = Retry(ConstantBackoff(0.05), 1)
    more = connection_options(url, password_file, ca_file)
    return redis.Redis.from_url(url, socket_timeout=timeout_s, socket_connect_timeout=min(timeout_s, 5.0), retry=retry, **more)


def connection_options(url: str, password_file: Path | None, ca_file: Path | None) -> dict[str, Any]:
    """What any of redis-py's connections is to be told besides the URL."""
    options: dict[str, Any] = {}
    if password_file is not None:
        options["password"] = password_file.read_text().partition("\n")[0].strip()
    if ca_file is not None and url.startswith("rediss://"):
        options["ssl_ca_certs"] = str(ca_file)
    return options
