"""A running service for the tests that need one: real HTTP, real queue, real worker processes, real EGL."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from client.api import Client
from client.local import LocalService
from client.shapes import write_ply
from tests import meshes

os.environ["SILHOUETTE_MEASURE"] = "false"  # of all processes that tests start, unless a test is about it

MAX_UPLOAD_MIB = 4
HULL_FACES, TEXELS = 200, 256


@pytest.fixture(scope="session")
def gpu():
    """The one context of this process's tests: a second would take its place."""
    from service.render.state import Gpu

    gpu = Gpu(64)
    yield gpu
    gpu.release()


@pytest.fixture(scope="session")
def service(tmp_path_factory):
    """A service of its own with one worker; refuses uploads over MAX_UPLOAD_MIB."""
    environment = {"SILHOUETTE_MAX_UPLOAD_MIB": str(MAX_UPLOAD_MIB), "SILHOUETTE_WARM_KERNELS": "0", "SILHOUETTE_MEASURE": "0"}
    with LocalService(tmp_path_factory.mktemp("service"), environment, ("--workers", "1")) as running:
        yield running
        assert running.stop() == 0, running.last_words()


@pytest.fixture(scope="session")
def client(service):
    with Client(service.url, timeout_s=120.0) as connected:
        yield connected


@pytest.fixture(scope="session")
def knot_file(tmp_path_factory) -> Path:
    """A torus knot of 5,120 faces."""
    path = tmp_path_factory.mktemp("meshes") / "small knot.ply"
    write_ply(str(path), *meshes.knot())
    return path


@pytest.fixture(scope="session")
def knot(client, knot_file):
    """The knot as a mesh that is ready."""
    accepted = client.upload(knot_file, hull_faces=HULL_FACES, texels=TEXELS)
    return client.wait(accepted.id, timeout_s=280.0)


def pytest_collection_modifyitems(items):
    """What uses the running service stays in one process of a parallel run, so that there is one service."""
    for item in items:
        if "service" in getattr(item, "fixturenames", ()):
            item.add_marker(pytest.mark.xdist_group("service"))
