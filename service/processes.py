"""Several service processes behind one listening socket, each with a renderer of its own: the kernel hands out connections."""

from __future__ import annotations

import os
import select
import signal
import socket
import sys
import time
from collections.abc import Callable
from pathlib import Path

from backend.settings import ENV_PREFIX
from service.children import Child, Supervisor
from service.embedded import StartupError
from service.settings import ServiceSettings

LISTENER_FLAG, READY_FLAG = "--listener", "--ready"
"""Flags of a process that another has started: numbers of an open socket, and of a pipe to say in that it serves."""
START_TIMEOUT_S = 60.0
READY = b"."


def serve_in_processes(settings: ServiceSettings, listener: socket.socket, announce: str, grace_s: float) -> int:
    """Serve with `settings.processes` processes until this one is interrupted; those that end are started again.

    announce: printed when all serve. grace_s: what requests under way get at the end. Raises StartupError, KeyboardInterrupt.
    """
    ended: list[int] = []
    supervisor = Supervisor()
    ready, told = os.pipe()
    try:
        supervisor.start()
        for number in range(1, settings.processes + 1):
            supervisor.add(_child(number, settings, listener, told, ended.append))
        _wait_for(ready, settings.processes, ended)
        print(announce, flush=True)
        while True:
            signal.pause()
    finally:
        supervisor.stop(grace_s)
        os.close(ready)
        os.close(told)


def say_ready(pipe: int) -> None:
    """Tell the process that started this one that it serves."""
    os.write(pipe, READY)
    os.close(pipe)


def _child(number: int, settings: ServiceSettings, listener: socket.socket, told: int, on_exit: Callable[[int], None]) -> Child:
    files = (listener.fileno(), told)
    command = (sys.executable, "-m", "service", LISTENER_FLAG, str(files[0]), READY_FLAG, str(files[1]))
    return Child(f"service-{number}", command, environment_of(settings), signal.SIGKILL, None, on_exit, files)


def environment_of(settings: ServiceSettings) -> dict[str, str]:
    """The settings that were given, as variables for a process that serves alone."""
    given = {name: getattr(settings, name) for name in settings.model_fields_set | {"redis_url"}}
    return {f"{ENV_PREFIX}{name.upper()}": _text(value) for name, value in given.items() if value is not None} | {
        f"{ENV_PREFIX}PROCESSES": "1"
    }


def _text(value: object) -> str:
    if isinstance(value, tuple):
        return ",".join(map(str, value))
    return str(value.absolute()) if isinstance(value, Path) else str(value)


def _wait_for(ready: int, count: int, ended: list[int]) -> None:
    deadline = time.monotonic() + START_TIMEOUT_S
    while count:
        if ended or time.monotonic() > deadline:
            raise StartupError("a service process did not start; see the log")
        if select.select([ready], [], [], 0.1)[0]:
            count -= len(os.read(ready, count))
