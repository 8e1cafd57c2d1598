"""Damaged files met by a running service: it says not ready, makes them again, and then answers as if nothing had been."""

import time

import httpx
import pytest

from client.shapes import write_ply
from schemas import artifacts
from tests import meshes


@pytest.fixture(scope="module")
def http(service):
    with httpx.Client(base_url=service.url, timeout=120.0) as connection:
        yield connection


def answered(http, path):
    """The first answer that is not 409, and how many 409 there were."""
    refusals = 0
    while (answer := http.get(path)).status_code == 409:
        assert answer.headers["retry-after"]
        refusals += 1
        time.sleep(0.1)
        assert refusals < 900
    return answer, refusals


def flip(service, mesh_id, name):
    path = service.data_dir / "store" / "meshes" / mesh_id / name
    before = path.read_bytes()
    path.write_bytes(before[:-5] + bytes([before[-5] ^ 1]) + before[-4:])
    return before


@pytest.mark.parametrize(
    ("name", "path"),
    [
        (artifacts.HULL.file, "thumbnail.png?size=64"),
        (artifacts.MESH.file, "silhouette.svg"),
        (artifacts.HULL_GLB, "artifacts/hull.glb"),
        (artifacts.HULL_SEQUENCE.file, "artifacts/hull.glb?faces=150"),
    ],
)
def test_a_damaged_file_is_answered_with_409_until_it_is_made_again(service, client, http, tmp_path, name, path):
    source = tmp_path / "sphere.ply"
    write_ply(str(source), *meshes.sphere(3, radius=1.0 + len(name + path) / 100.0))
    mesh = client.wait(client.upload(source, hull_faces=100, texels=64).id, timeout_s=200.0)
    before = flip(service, mesh.id, name)
    answer, refusals = answered(http, f"/v1/meshes/{mesh.id}/{path}")
    assert answer.status_code == 200 and refusals >= 1
    assert client.wait(mesh.id, timeout_s=200.0).status == "ready"
    assert (service.data_dir / "store" / "meshes" / mesh.id / name).read_bytes() == before
