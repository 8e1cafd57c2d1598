"""A measurement in a process of its own: what it breaks or fills up is its own, and its memory can be told."""

from __future__ import annotations

import multiprocessing
import resource
import traceback
from collections.abc import Callable
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from benchmarks.models import AbsentError

SPAWN = multiprocessing.get_context("spawn")
GRACE_S = 10.0
STATUS = Path("/proc/self/status")


class FailedError(RuntimeError):
    """The measurement raised, died, or took too long; the text is one sentence for a table."""


def isolated(function: Callable[..., Any], *arguments: Any, limit_s: float = 3600.0) -> tuple[Any, float]:
    """(what the function returns, the most its process had resident, MiB). The function and all values must be picklable.

    Raises AbsentError when the function does, FailedError when it raises anything else, dies, or takes longer than limit_s.
    """
    ours, theirs = SPAWN.Pipe(duplex=False)
    process = SPAWN.Process(target=_answer, args=(theirs, function, arguments))
    process.start()
    theirs.close()
    try:
        if not ours.poll(limit_s):
            raise FailedError(f"not done after {limit_s:.0f} s")
        fault, value, mib = ours.recv()
    except EOFError:
        process.join(GRACE_S)
        raise FailedError(f"its process ended with status {process.exitcode}") from None
    finally:
        process.kill()
        process.join()
        ours.close()
    if fault is not None:
        raise fault
    return value, mib


def _answer(connection: Connection, function: Callable[..., Any], arguments: tuple[Any, ...]) -> None:
    fault: Exception | None = None
    value = None
    try:
        value = function(*arguments)
    except AbsentError as error:
        fault = AbsentError(str(error))
    except SystemExit as error:
        fault = FailedError(str(error))
    except Exception as error:
        traceback.print_exc()
        fault = FailedError(f"{type(error).__name__}: {error}")
    connection.send((fault, value, peak_mib()))
    connection.close()


def peak_mib() -> float:
    """The most this process had resident, MiB. Not getrusage's, which counts what its parent had before it was started."""
    if not STATUS.exists():
        return round(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0, 1)
    kib = next(line.split()[1] for line in STATUS.read_text().splitlines() if line.startswith("VmHWM:"))
    return round(int(kib) / 1024.0, 1)
