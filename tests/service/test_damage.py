"""Damaged files met by a running service: it says not ready, makes them again, and then answers as if nothing had been."""

import hashlib
import time

import pytest

from client.shapes import write_ply
from schemas import artifacts
from tests import meshes, plain_http


@pytest.fixture(scope="module")
def http(service):
    with plain_http.Client(base_url=service.url, timeout=120.0) as connection:
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


def test_a_damaged_upload_is_said_and_sending_it_again_makes_the_mesh(service, client, http, tmp_path):
    """Found when its mesh is to be read again, for what was made of it is damaged, too."""
    source = tmp_path / "sphere.ply"
    write_ply(str(source), *meshes.sphere(2, radius=0.77))
    mesh = client.wait(client.upload(source, hull_faces=60, texels=64).id, timeout_s=200.0)
    flip(service, mesh.id, artifacts.MESH.file)
    stored = service.data_dir / "store" / "uploads" / hashlib.sha256(source.read_bytes()).hexdigest()
    stored.write_bytes(stored.read_bytes()[:-1])
    answer, _ = answered(http, f"/v1/meshes/{mesh.id}/silhouette.svg")
    assert (answer.status_code, answer.json()["code"]) == (422, "damaged-upload")
    assert client.info(mesh.id).status == "failed"
    again = http.post("/v1/meshes", params={"name": source.name, "hull_faces": 60, "texels": 64}, content=source.read_bytes())
    assert (again.status_code, again.json()["id"]) == (202, mesh.id)
    assert client.wait(mesh.id, timeout_s=200.0).status == "ready"
    assert stored.read_bytes() == source.read_bytes()
    assert answered(http, f"/v1/meshes/{mesh.id}/silhouette.svg")[0].status_code == 200
