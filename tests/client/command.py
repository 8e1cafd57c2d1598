"""The `silhouette` command: as its entry point runs in this process, or as the installed program in a process of its own."""

from __future__ import annotations

import io
import os
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path

import pytest

from client.cli import main

Done = subprocess.CompletedProcess[bytes]
PROGRAM = str(Path(sys.executable).with_name("silhouette"))


def words_of(arguments: tuple[object, ...], url: str | None) -> list[str]:
    return [*map(str, arguments), *(["--url", url] if url else [])]


def silhouette(
    *arguments: object, url: str | None = None, cwd: Path | None = None, env: Mapping[str, str] | None = None, said: bytes = b""
) -> Done:
    """What the command writes and how it ends. env: all of its environment; this process's if not given. said: its standard input."""
    command = ["silhouette", *words_of(arguments, url)]
    out, err = io.TextIOWrapper(io.BytesIO(), "utf-8"), io.TextIOWrapper(io.BytesIO(), "utf-8")
    with pytest.MonkeyPatch.context() as patch:
        for name, value in {"argv": command, "stdin": io.TextIOWrapper(io.BytesIO(said)), "stdout": out, "stderr": err}.items():
            patch.setattr(sys, name, value)
        if env is not None:
            for name in list(os.environ):
                patch.delenv(name)
            for name, value in env.items():
                patch.setenv(name, value)
        if cwd is not None:
            patch.chdir(cwd)
        status = _status_of_main()
    written = []
    for stream in (out, err):
        stream.flush()
        written.append(stream.buffer.getvalue())
    return subprocess.CompletedProcess(command, status, *written)


def silhouette_process(*arguments: object, url: str | None = None, said: bytes = b"") -> Done:
    """The same of the installed program, through pipes."""
    return subprocess.run([PROGRAM, *words_of(arguments, url)], input=said, capture_output=True, timeout=250, check=False)


def _status_of_main() -> int:
    try:
        main()
    except SystemExit as ended:
        assert ended.code is None or isinstance(ended.code, int), ended.code
        return ended.code or 0
    return 0
