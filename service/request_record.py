"""What is noted of the request that is being answered, for its log line, metrics and problem: by context, wherever it is found out."""

from __future__ import annotations

import random
import re
from contextvars import ContextVar
from dataclasses import dataclass

from backend.logs import bind
from backend.tracing import REQUEST

REQUEST_ID = "X-Request-Id"

GOOD_ID = re.compile(r"[A-Za-z0-9._-]{1,64}")
"""Of a request id that a client or proxy gives; another one is replaced."""

UNMATCHED = "unmatched"
"""Route of a request that reached none."""


@dataclass
class RequestRecord:
    """id: of the request. route: template of its address. mesh: id in it. key: id of its API key. code: of the problem it ended with."""

    id: str
    route: str = UNMATCHED
    mesh: str | None = None
    key: str | None = None
    code: str | None = None


_CURRENT: ContextVar[RequestRecord | None] = ContextVar("request_record", default=None)


def begin_request(given_id: str | None) -> RequestRecord:
    """The record of a request that comes now; log lines have its id from here on. Every request has a task, so nothing ends this."""
    record = RequestRecord(given_id if given_id is not None and GOOD_ID.fullmatch(given_id) else f"{random.getrandbits(128):032x}")
    _CURRENT.set(record)
    bind(**{REQUEST: record.id})
    return record


def current_request() -> RequestRecord | None:
    """The request that is being answered here; None outside of one."""
    return _CURRENT.get()
