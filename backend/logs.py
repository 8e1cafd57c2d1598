"""Log lines as JSON objects on stderr, one a line."""

from __future__ import annotations

import json
import logging
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from datetime import UTC, datetime
from types import MappingProxyType

STANDARD = frozenset(logging.makeLogRecord({}).__dict__) | {"message", "asctime", "taskName"}

_BOUND: ContextVar[Mapping[str, str]] = ContextVar("log_context", default=MappingProxyType({}))


def bind(**values: str) -> None:
    """Have every log line of this task, and of what it starts from now on, say these, too."""
    _BOUND.set({**_BOUND.get(), **values})


@contextmanager
def bound(**values: str) -> Iterator[None]:
    """The same inside the block alone."""
    token = _BOUND.set({**_BOUND.get(), **values})
    try:
        yield
    finally:
        _BOUND.reset(token)


def bound_values() -> Mapping[str, str]:
    """What log lines say here."""
    return _BOUND.get()


class JsonFormatter(logging.Formatter):
    """Time, level, logger, process, message, what is bound here, what was passed as `extra`, and the trace of an exception."""

    def __init__(self, process: str) -> None:
        super().__init__()
        self._process = process

    def format(self, record: logging.LogRecord) -> str:
        """One JSON object."""
        line = {
            "time": datetime.fromtimestamp(record.created, UTC).isoformat(timespec="milliseconds"),
            "level": record.levelname,
            "logger": record.name,
            "process": self._process,
            "message": record.getMessage(),
            **_BOUND.get(),
            **{name: value for name, value in record.__dict__.items() if name not in STANDARD},
        }
        if record.exc_info:
            line["trace"] = self.formatException(record.exc_info)
        return json.dumps(line, default=str)


def configure_logs(process: str, level: str) -> None:
    """Send all log lines of this process to stderr, from `level` on. `process` names it in each line."""
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(JsonFormatter(process))
    logging.basicConfig(level=level, handlers=[handler], force=True)
    # no line says them, and finding them out takes longer than writing it
    logging._srcfile, logging.logThreads, logging.logProcesses, logging.logMultiprocessing = None, False, False, False
    for chatty in ("rq.worker", "rq.job", "rq.queue"):  # a line for each job and each look around, every two seconds
        logging.getLogger(chatty).setLevel(logging.DEBUG if level == "DEBUG" else logging.WARNING)
