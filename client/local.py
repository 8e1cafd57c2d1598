"""What is done on this machine by the service's own programs: a service for as long as it is needed, and keys in the data folder."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import IO, Any, Self

from pydantic_core import to_jsonable_python

from schemas.access import KeyInfo, KeyPage, MadeKey

START_TIMEOUT_S = 60.0
STOP_TIMEOUT_S = 15.0
READY_LINE = "Silhouette Service on "


class LocalServiceError(Exception):
    """The service could not be started, or a program of it failed; the message ends with what it said last."""


class LocalService:
    """`python -m service` on a free port, ready on entering and gone on leaving, its workers too.

    It also ends when this process is killed, since then its standard input closes.
    """

    def __init__(self, data_dir: Path, environment: Mapping[str, str] | None = None, arguments: tuple[str, ...] = ()) -> None:
        self.data_dir = data_dir
        self.url = ""
        self._log = data_dir / "service.log"
        self._environment = {**os.environ, **(environment or {})}
        self._arguments = arguments
        self._process: subprocess.Popen[str] | None = None

    @property
    def pid(self) -> int:
        """Process id of the service; its children are in its supervisor's hands."""
        assert self._process is not None
        return self._process.pid

    def __enter__(self) -> Self:
        self.data_dir.mkdir(parents=True, exist_ok=True)
        command = [sys.executable, "-m", "service", "--port", "0", "--data-dir", str(self.data_dir), "--while-stdin", *self._arguments]
        with self._log.open("wb") as log:
            self._process = subprocess.Popen(
                command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=log, text=True, env=self._environment
            )
        try:
            self.url = self._address(self._process)
        except BaseException:
            self.stop()
            raise
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self.stop()

    def stop(self) -> int:
        """Stop the service and what it started; its exit status."""
        process = self._process
        if process is None:
            return 0
        if process.poll() is None:
            process.send_signal(signal.SIGTERM)
        try:
            process.wait(STOP_TIMEOUT_S)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
        for pipe in (process.stdin, process.stdout):
            if pipe is not None:
                pipe.close()
        return process.returncode

    def last_words(self) -> str:
        """The end of the service's log."""
        return "\n".join(self._log.read_text(errors="replace").splitlines()[-12:])

    def _address(self, process: subprocess.Popen[str]) -> str:
        """What it prints when it is ready."""
        assert process.stdout is not None
        watchdog = threading.Timer(START_TIMEOUT_S, process.kill)
        watchdog.start()
        try:
            line = _first_line(process.stdout)
        finally:
            watchdog.cancel()
        if not line.startswith(READY_LINE):
            process.wait(STOP_TIMEOUT_S)
            raise LocalServiceError(f"the service did not start:\n{self.last_words()}")
        return line.removeprefix(READY_LINE).strip()


class LocalKeys:
    """The API keys in a data folder, that of the settings if none is given; the calls are those of `Client`. Raises LocalServiceError."""

    def __init__(self, data_dir: Path | None = None) -> None:
        self._folder = () if data_dir is None else ("--data-dir", str(data_dir))

    def keys(self) -> Sequence[KeyInfo]:
        """All keys."""
        return KeyPage.model_validate_json(self._run("list")).keys

    def add_key(self, name: str, **fields: Any) -> MadeKey:
        """Make a key; its token is in the answer alone."""
        wanted = to_jsonable_python({"name": name, **fields}, exclude_none=True)
        return MadeKey.model_validate_json(self._run("add", said=json.dumps(wanted)))

    def revoke_key(self, key_id: str) -> None:
        """Revoke a key and all that it signed."""
        self._run("revoke", key_id)

    def _run(self, *arguments: str, said: str = "") -> str:
        command = [sys.executable, "-m", "service.access", *self._folder, *arguments]
        done = subprocess.run(command, input=said, capture_output=True, text=True, check=False)
        if done.returncode != 0:
            raise LocalServiceError(done.stderr.strip().rpartition("\n")[2])
        return done.stdout


def _first_line(stream: IO[str]) -> str:
    for line in stream:
        if line.startswith(READY_LINE):
            return line
    return ""
