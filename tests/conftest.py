"""A running service for the tests that need one: real HTTP, real queue, real worker processes, real EGL."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

import httpx
import pytest

from backend.local_store import LocalStore
from client.api import Client
from client.local import LocalService
from client.shapes import write_ply
from schemas.access import NewKey
from service.access.keys import KeyStore
from tests import meshes, plain_http

os.environ["SILHOUETTE_MEASURE"] = "false"  # of all processes that tests start, unless a test is about it
os.environ["SILHOUETTE_WARM_RENDERER"] = "false"  # likewise: most services of tests draw little, and end soon
os.environ["SILHOUETTE_NICE"] = "0"  # likewise: tests wait for workers, and run beside other tests

MAX_UPLOAD_MIB = 4
HULL_FACES, TEXELS = 200, 256

ORIGIN = "https://shop.example"
GUARDED_ENVIRONMENT = {
    "SILHOUETTE_REQUIRE_KEYS": "1",
    "SILHOUETTE_CORS_ORIGINS": ORIGIN,
    "SILHOUETTE_BEHIND_TLS": "1",
    "SILHOUETTE_WARM_KERNELS": "0",
}
GUARDED_KEYS = {
    "reader": {"scopes": ["read"]},
    "writer": {"scopes": ["write"]},
    "admin": {"scopes": ["admin"]},
    "everything": {"scopes": ["read", "write", "admin"]},
    "small": {"scopes": ["read", "write"], "limits": {"max_pixels": 10_000, "max_faces": 1000, "max_upload_mib": 1}},
    "slow": {"scopes": ["read"], "limits": {"requests_per_minute": 5}},
    "two": {"scopes": ["read"], "limits": {"requests_per_minute": 2}},
    "single": {"scopes": ["read"], "limits": {"concurrent_renders": 1}},
    "brief": {"scopes": ["read"], "expires_in_days": 1e-6},
}


@dataclass(frozen=True)
class Guarded:
    """The service, and the tokens of its keys by name."""

    running: LocalService
    tokens: dict[str, str]

    def http(self, key: str | None = None) -> httpx.Client:
        headers = {} if key is None else {"Authorization": f"Bearer {self.tokens[key]}"}
        return plain_http.Client(base_url=self.running.url, timeout=120.0, headers=headers)


@pytest.fixture(scope="session")
def gpu():
    """The one context of this process's tests: a second would take its place."""
    from service.render.state import Gpu

    gpu = Gpu(64)
    yield gpu
    gpu.release()


@pytest.fixture(scope="session")
def routes() -> list[tuple[str, str]]:
    """(method, path) of every call in the service's document."""
    from service.app import create_app
    from service.settings import ServiceSettings

    paths = create_app(ServiceSettings()).openapi()["paths"]
    return [(method.upper(), path) for path, methods in paths.items() for method in methods]


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


@pytest.fixture(scope="session")
def guarded(tmp_path_factory):
    """A service that asks for keys, with one key of each sort."""
    data_dir = tmp_path_factory.mktemp("guarded")
    keys = KeyStore(LocalStore(data_dir / "store"))
    tokens = {name: keys.add(NewKey(name=name, **fields)).token for name, fields in GUARDED_KEYS.items()}
    with LocalService(data_dir, GUARDED_ENVIRONMENT, ("--workers", "1")) as running:
        yield Guarded(running, tokens)
        assert running.stop() == 0, running.last_words()


@pytest.fixture(scope="session")
def guarded_cube(guarded, tmp_path_factory):
    """A mesh that is ready there."""
    path = tmp_path_factory.mktemp("cube") / "cube.ply"
    write_ply(str(path), *meshes.cube(4))
    with Client(guarded.running.url, timeout_s=120.0, key=guarded.tokens["everything"]) as client:
        return client.wait(client.upload(path, hull_faces=100, texels=64).id, timeout_s=200.0)


def pytest_collection_modifyitems(items):
    """What uses the running service stays in one process of a parallel run, so that there is one service."""
    for item in items:
        for name in ("service", "guarded"):
            if name in getattr(item, "fixturenames", ()):
                item.add_marker(pytest.mark.xdist_group(name))
