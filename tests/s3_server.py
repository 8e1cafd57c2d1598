"""A server that speaks S3, as a process of its own: moto, which keeps its objects in memory. `python -m tests.s3_server` runs it."""

from __future__ import annotations

import io
import os
import signal
import subprocess
import sys
import threading
import urllib.request
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Self

BUCKET = "meshes-of-tests"
CREDENTIALS = {"AWS_ACCESS_KEY_ID": "tests", "AWS_SECRET_ACCESS_KEY": "the-secret-of-tests", "AWS_REGION": "us-east-1"}
START_S = 60.0
READY = "listening on "


class S3Server:
    """Runs on a free port of this machine inside `with`, with one empty bucket.

    Requests are answered one at a time once their bodies have come: moto itself looks at a condition and acts on it in two steps.
    """

    def __init__(self, environment: Mapping[str, str] | None = None) -> None:
        self._environment = {**os.environ, **(environment or {})}
        self.endpoint = ""

    @property
    def settings(self) -> dict[str, str]:
        """Environment of a process that uses it."""
        return {"SILHOUETTE_STORE_URL": f"s3://{BUCKET}/of/tests", "SILHOUETTE_STORE_ENDPOINT": self.endpoint, **CREDENTIALS}

    def __enter__(self) -> Self:
        root = Path(__file__).resolve().parent.parent
        self._process = subprocess.Popen(
            [sys.executable, "-m", "tests.s3_server"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
            cwd=root,
            env=self._environment,
        )
        assert self._process.stdout is not None
        watchdog = threading.Timer(START_S, self._process.kill)
        watchdog.start()
        line = self._process.stdout.readline()
        watchdog.cancel()
        assert line.startswith(READY), "moto did not start; are moto, flask and flask-cors installed?"
        self.endpoint = line.removeprefix(READY).strip()
        return self

    def __exit__(self, *_: object) -> None:
        self._process.kill()
        self._process.wait()
        for pipe in (self._process.stdin, self._process.stdout):
            if pipe is not None:
                pipe.close()

    def pause(self) -> None:
        """Answer nobody any more."""
        self._process.send_signal(signal.SIGSTOP)

    def resume(self) -> None:
        """Answer again, with everything still there."""
        self._process.send_signal(signal.SIGCONT)


class OneAtATime:
    """A WSGI application whose calls do not overlap."""

    def __init__(self, application: Any) -> None:
        self._application = application
        self._lock = threading.Lock()

    def __call__(self, environment: dict[str, Any], start_response: Any) -> list[bytes]:
        length = int(environment.get("CONTENT_LENGTH") or 0)
        body = environment["wsgi.input"].read(length)
        if len(body) < length:
            raise ConnectionError("the client left")
        environment["wsgi.input"] = io.BytesIO(body)
        with self._lock:
            return list(self._application(environment, start_response))


def main() -> None:
    """Serve until standard input is closed, as it is when the tests die."""
    from moto.server import create_backend_app
    from werkzeug.serving import make_server

    server = make_server("127.0.0.1", 0, OneAtATime(create_backend_app("s3")), threaded=True)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    endpoint = f"http://127.0.0.1:{server.server_port}"
    if "INITIAL_NO_AUTH_ACTION_COUNT" not in os.environ:
        urllib.request.urlopen(urllib.request.Request(f"{endpoint}/{BUCKET}", method="PUT")).close()
    print(f"{READY}{endpoint}", flush=True)
    sys.stdin.read()
    os._exit(0)


if __name__ == "__main__":
    main()
