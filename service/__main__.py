"""`python -m service`: the HTTP service, with its private queue server and workers unless a Redis is named."""

from __future__ import annotations

import argparse
import asyncio
import math
import os
import resource
import signal
import socket
import sys
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import uvicorn
from fastapi import FastAPI
from pydantic import ValidationError

from backend.logs import configure_logs
from backend.settings import setting_faults
from service.access.policy import startup_fault
from service.embedded import EmbeddedBackend, StartupError
from service.processes import LISTENER_FLAG, READY_FLAG, say_ready, serve_in_processes
from service.settings import ServiceSettings

BACKLOG = 512
MOST_FILES = 1 << 16
"""Open files that a process takes if it may: connections, and maps of artifacts, each of which keeps one open."""


def main() -> int:
    """Run the service until SIGINT or SIGTERM; the exit status."""
    try:
        settings, start = parse(sys.argv[1:])
    except ValidationError as error:
        print(*setting_faults(error), sep="\n", file=sys.stderr)
        return 2
    configure_logs("service", settings.log_level)
    if fault := startup_fault(settings):
        print(f"error: {fault}", file=sys.stderr)
        return 2
    signal.signal(signal.SIGTERM, _interrupt)
    allow_files()
    if start.while_stdin:
        threading.Thread(target=_end_with_stdin, name="stdin", daemon=True).start()
    if settings.processes == 1:
        from service import app  # now, while the workers do not yet compete for the processors with imports of their own
    try:
        with _listening(settings, start.listener) as listener, _backend(settings) as connected:
            if connected.processes > 1:
                return serve_in_processes(connected, listener, _announcement(listener), connected.stop_grace_s)
            return _serve(app.create_app(connected), listener, start.ready, connected.stop_grace_s)
    except StartupError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        return 0


@dataclass(frozen=True)
class Start:
    """How a process was started. while_stdin: it ends with its standard input. listener: number of a bound socket that it got, ready: of
    a pipe to say in that it serves (`service.processes`)."""

    while_stdin: bool
    listener: int | None
    ready: int | None


def parse(arguments: Sequence[str]) -> tuple[ServiceSettings, Start]:
    """Settings from the environment, overridden by flags; and how the process was started. Raises ValidationError."""
    parser = argparse.ArgumentParser(prog="python -m service", description="The silhouette service. Every other setting is SILHOUETTE_*.")
    parser.add_argument("--host", help="address to listen on (127.0.0.1)")
    parser.add_argument("--port", type=int, help="port to listen on (8000); 0 takes a free one")
    parser.add_argument("--data-dir", type=Path, help="folder of everything that is kept")
    parser.add_argument("--workers", type=int, help="worker processes to start (one a processor)")
    parser.add_argument("--insecure", action="store_const", const=True, help="listen for other machines though there is no key")
    parser.add_argument("--processes", type=int, help="service processes behind the port (1)")
    parser.add_argument(LISTENER_FLAG, type=int, help=argparse.SUPPRESS)
    parser.add_argument(READY_FLAG, type=int, help=argparse.SUPPRESS)
    parser.add_argument("--while-stdin", action="store_true", help="end when standard input is closed, as it is when a parent dies")
    flags = vars(parser.parse_args(arguments))
    start = Start(bool(flags.pop("while_stdin")), flags.pop("listener"), flags.pop("ready"))
    return ServiceSettings(**{name: value for name, value in flags.items() if value is not None}), start


@contextmanager
def _listening(settings: ServiceSettings, given: int | None) -> Iterator[socket.socket]:
    """A bound socket, the given one or one of our own: the port is known, and is ours, before anything is started. Raises StartupError."""
    if given is not None:
        with socket.socket(fileno=given) as listener:
            yield listener
        return
    family = socket.AF_INET6 if ":" in settings.host else socket.AF_INET
    with socket.socket(family, socket.SOCK_STREAM) as listener:
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            listener.bind((settings.host, settings.port))
        except OSError as error:
            raise StartupError(f"cannot listen on {settings.host} port {settings.port}: {error.strerror}") from error
        yield listener


@contextmanager
def _backend(settings: ServiceSettings) -> Iterator[ServiceSettings]:
    """Settings that name a Redis: the given ones, or those of a private one that runs inside the block."""
    if settings.redis_url is not None:
        yield settings
        return
    store = {} if settings.store_url is None else {"SILHOUETTE_STORE_URL": settings.store_url}
    backend = EmbeddedBackend(settings.data_dir, settings.workers, {**store, "SILHOUETTE_LOG_LEVEL": settings.log_level})
    backend.start()
    try:
        yield settings.model_copy(update={"redis_url": backend.redis_url})
    finally:
        for number in (signal.SIGINT, signal.SIGTERM):  # one is enough: a second must not leave the children behind
            signal.signal(number, signal.SIG_IGN)
        backend.stop()


def _announcement(listener: socket.socket) -> str:
    host, port = listener.getsockname()[:2]
    return f"Silhouette Service on http://{f'[{host}]' if ':' in host else host}:{port}"


def _serve(app: FastAPI, listener: socket.socket, ready: int | None, grace_s: float) -> int:
    """ready: of a pipe to say in that it serves. grace_s: seconds that requests under way get to end when the service stops."""
    config = uvicorn.Config(
        app,
        log_config=None,
        log_level="warning",
        access_log=False,
        server_header=False,
        backlog=BACKLOG,
        timeout_graceful_shutdown=math.ceil(grace_s),
        lifespan="on",
    )
    server = uvicorn.Server(config)

    async def run() -> int:
        serving = asyncio.create_task(server.serve(sockets=[listener]))
        while not (server.started or serving.done()):
            await asyncio.sleep(0.01)
        fault = app.state.services.renderer_fault if server.started else "the service did not start; see the log"
        if fault is None and ready is not None:
            say_ready(ready)
        elif fault is None:
            print(_announcement(listener), flush=True)
        else:
            print(f"error: {fault}", file=sys.stderr)
            server.should_exit = True
        await serving
        return 0 if fault is None else 1

    with asyncio.Runner(loop_factory=config.get_loop_factory()) as runner:
        return runner.run(run())


def allow_files() -> None:
    """Take as many open files as the system lets: what it gives unasked is for programs that open few."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    most = MOST_FILES if hard == resource.RLIM_INFINITY else min(hard, MOST_FILES)
    if soft != resource.RLIM_INFINITY and soft < most:
        resource.setrlimit(resource.RLIMIT_NOFILE, (most, hard))


def _interrupt(number: int, frame: object) -> None:
    raise KeyboardInterrupt


def _end_with_stdin() -> None:
    while sys.stdin.buffer.read(4096):
        pass
    os.kill(os.getpid(), signal.SIGTERM)


if __name__ == "__main__":
    status = main()
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(status)  # a kernel that is still being compiled in a thread does not hold up the end
