"""Several processes behind one port: all of them answer, one that dies is missed by nobody, and none outlives the first."""

from __future__ import annotations

import io
import os
import signal
import time
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from backend.settings import ENV_PREFIX
from benchmarks.service import processor_s
from client.api import Client
from client.local import LocalService, LocalServiceError
from client.shapes import write_ply
from service.processes import environment_of
from service.settings import ServiceSettings
from tests import meshes, plain_http


def serving(parent: int) -> list[int]:
    """Process ids of the service processes that a process has started."""
    found = []
    for entry in Path("/proc").iterdir():
        try:
            if entry.name.isdigit() and f"\nPPid:\t{parent}\n" in (entry / "status").read_text():
                words = (entry / "cmdline").read_bytes().split(b"\0")
                found += [int(entry.name)] if b"--listener" in words else []
        except (FileNotFoundError, ProcessLookupError):
            continue
    return sorted(found)


def alive(pids: list[int]) -> list[int]:
    return [pid for pid in pids if Path(f"/proc/{pid}").exists()]


def test_all_processes_answer_alike_one_that_is_killed_is_replaced_and_stopping_the_first_stops_all(tmp_path):
    path = tmp_path / "torus.ply"
    write_ply(str(path), *meshes.torus())
    arguments = ("--workers", "1", "--processes", "2")
    with LocalService(tmp_path / "data", {"SILHOUETTE_MEASURE": "false"}, arguments) as pair, Client(pair.url) as client:
        mesh = client.wait(client.upload(path, hull_faces=60, texels=64).id, timeout_s=200.0)
        picture = f"{pair.url}/v1/meshes/{mesh.id}/render.png?width=64&height=64&azimuth="
        first = serving(pair.pid)
        assert len(first) == 2
        before = [processor_s(pid) for pid in first]
        images = [np.asarray(Image.open(io.BytesIO(plain_http.get(f"{picture}12", timeout=60.0).content))) for _ in range(40)]
        assert all(np.array_equal(images[0], image) for image in images)
        assert images[0][..., 3].any()
        assert all(processor_s(pid) > spent for pid, spent in zip(first, before, strict=True)), "each has answered some"

        os.kill(first[0], signal.SIGKILL)
        deadline = time.monotonic() + 60.0
        while len(serving(pair.pid)) < 2 or first[0] in serving(pair.pid):
            assert time.monotonic() < deadline
            assert plain_http.get(f"{picture}13", timeout=60.0).status_code == 200
            time.sleep(0.02)
        assert Counter(plain_http.get(f"{picture}{n}", timeout=60.0).status_code for n in range(20)) == {200: 20}

        pids = [*serving(pair.pid), pair.pid]
        assert len(pids) == 3
        assert pair.stop() == 0
        assert not alive(pids)


def test_killing_the_first_kills_all(tmp_path):
    with LocalService(tmp_path, {}, ("--workers", "0", "--processes", "2")) as running:
        pids = serving(running.pid)
        os.kill(running.pid, signal.SIGKILL)
        deadline = time.monotonic() + 15.0
        while alive(pids):
            assert time.monotonic() < deadline
            time.sleep(0.05)


def test_a_process_that_cannot_start_stops_the_rest_with_a_reason(tmp_path):
    with (
        pytest.raises(LocalServiceError, match="did not start"),
        LocalService(tmp_path, {"SILHOUETTE_REDIS_URL": "redis://127.0.0.1:1/0"}, ("--processes", "2", "--data-dir", "/proc/none")),
    ):
        raise AssertionError("it serves")


def test_settings_reach_the_processes_as_they_were_given():
    given = ServiceSettings(redis_url="unix:///x", data_dir="/somewhere", cors_origins="https://a.example,https://b.example", processes=3)
    environment = environment_of(given)
    assert environment[f"{ENV_PREFIX}PROCESSES"] == "1"
    assert environment[f"{ENV_PREFIX}CORS_ORIGINS"] == "https://a.example,https://b.example"
    assert (environment[f"{ENV_PREFIX}DATA_DIR"], environment[f"{ENV_PREFIX}REDIS_URL"]) == ("/somewhere", "unix:///x")
