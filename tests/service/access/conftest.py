"""A running service that asks for keys, with one key of each sort."""

from __future__ import annotations

from dataclasses import dataclass

import httpx
import pytest

from client.api import Client
from client.local import LocalKeys, LocalService
from client.shapes import write_ply
from tests import meshes

ORIGIN = "https://shop.example"
ENVIRONMENT = {
    "SILHOUETTE_REQUIRE_KEYS": "1",
    "SILHOUETTE_CORS_ORIGINS": ORIGIN,
    "SILHOUETTE_BEHIND_TLS": "1",
    "SILHOUETTE_WARM_KERNELS": "0",
}
KEYS = {
    "reader": {"scopes": ["read"]},
    "writer": {"scopes": ["write"]},
    "admin": {"scopes": ["admin"]},
    "everything": {"scopes": ["read", "write", "admin"]},
    "small": {"scopes": ["read", "write"], "limits": {"max_pixels": 10_000, "max_faces": 1000, "max_upload_mib": 1}},
    "slow": {"scopes": ["read"], "limits": {"requests_per_minute": 5}},
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
        return httpx.Client(base_url=self.running.url, timeout=120.0, headers=headers)


@pytest.fixture(scope="session")
def guarded(tmp_path_factory):
    data_dir = tmp_path_factory.mktemp("guarded")
    keys = LocalKeys(data_dir)
    tokens = {name: keys.add_key(name, **fields).token for name, fields in KEYS.items()}
    with LocalService(data_dir, ENVIRONMENT, ("--workers", "1")) as running:
        yield Guarded(running, tokens)
        assert running.stop() == 0, running.last_words()


@pytest.fixture(scope="session")
def cube(guarded, tmp_path_factory):
    """A mesh that is ready there."""
    path = tmp_path_factory.mktemp("cube") / "cube.ply"
    write_ply(str(path), *meshes.cube(4))
    with Client(guarded.running.url, timeout_s=120.0, key=guarded.tokens["everything"]) as client:
        return client.wait(client.upload(path, hull_faces=100, texels=64).id, timeout_s=200.0)


@pytest.fixture
def anyone(guarded):
    """HTTP without a key."""
    with guarded.http() as http:
        yield http


@pytest.fixture
def everything(guarded):
    with guarded.http("everything") as http:
        yield http
