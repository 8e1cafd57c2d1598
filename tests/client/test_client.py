"""The Python client against a running service, and where there is none."""

import socket

import pytest

from client import Client
from client.api import _passes
from client.errors import (
    MeshFailedError,
    NotFoundError,
    NotReadyError,
    RequestError,
    TooLargeError,
    UnknownFormatError,
    UnreachableError,
)
from client.shapes import write_ply
from schemas.render import Camera
from tests import meshes
from tests.conftest import HULL_FACES, MAX_UPLOAD_MIB, TEXELS


def test_upload_reports_every_byte_and_wait_every_stage(client, tmp_path):
    path = tmp_path / "cube.ply"
    write_ply(str(path), *meshes.cube(3))
    sent, seen = [], []
    accepted = client.upload(path, on_progress=lambda done, total: sent.append((done, total)), hull_faces=40, texels=64)
    mesh = client.wait(accepted.id, on_progress=seen.append, timeout_s=120.0)
    assert sent[-1] == (path.stat().st_size, path.stat().st_size)
    assert seen[-1].status == mesh.status == "ready"
    assert all(stage.status == "done" for stage in mesh.stages)
    client.delete(mesh.id)


def test_picture_says_its_passes(client, knot):
    picture = client.picture(knot.id, width=64, height=64, camera=Camera(eye=[0.0, 0.0, 12.0]))
    assert picture.media_type == "image/png"
    assert picture.passes[-1][0] == "encode"
    assert picture.frame_ms == pytest.approx(sum(ms for _, ms in picture.passes[:-1]))
    assert client.render(knot.id, width=64, height=64, camera={"eye": [0, 0, 12]}) == picture.body


def test_silhouette_is_a_dictionary_and_a_drawing(client, knot):
    silhouette = client.silhouette(knot.id, camera={"orbit": {"azimuth_deg": 10}})
    assert silhouette["edge_count"] == len(silhouette["edges"]) > 10
    assert b"<svg" in client.silhouette_document(knot.id, "svg")[:300]


def test_downloads_and_thumbnail(client, knot):
    assert client.download(knot.id)[:4] == b"glTF"
    assert client.download(knot.id, "normal.png")[:4] == b"\x89PNG"
    assert client.thumbnail(knot.id, 32, "webp")[8:12] == b"WEBP"


def test_list_goes_over_pages_and_stops_at_the_limit(client, knot):
    everything = [mesh.id for mesh in client.list()]
    assert knot.id in everything
    assert [mesh.id for mesh in client.list(1)] == everything[:1]


def test_errors_are_typed(client, knot, tmp_path):
    with pytest.raises(NotFoundError):
        client.info("0" * 32)
    with pytest.raises(RequestError) as wrong:
        client.render(knot.id, width=0)
    assert wrong.value.fields == [{"field": "width", "message": "should be greater than or equal to 1"}]
    odd, empty, big = tmp_path / "a.blend", tmp_path / "empty.stl", tmp_path / "big.ply"
    odd.write_bytes(b"BLENDER")
    empty.write_bytes(b"")
    big.write_bytes(bytes((MAX_UPLOAD_MIB << 20) + 1))
    for path, kind in ((odd, UnknownFormatError), (empty, MeshFailedError), (big, TooLargeError)):
        with pytest.raises(kind):
            client.upload(path)


def test_mesh_that_is_not_ready_says_so(client, knot_file):
    accepted = client.upload(knot_file, hull_faces=HULL_FACES + 1, texels=TEXELS)
    with pytest.raises(NotReadyError):
        client.render(accepted.id)
    client.delete(accepted.id)


def test_mesh_deleted_while_waiting_is_not_found(client, knot_file):
    accepted = client.upload(knot_file, hull_faces=HULL_FACES + 2, texels=TEXELS)
    with pytest.raises(NotFoundError):
        client.wait(accepted.id, on_progress=lambda _: client.delete(accepted.id))


def test_nobody_there_is_one_clear_error():
    with socket.socket() as closed:
        closed.bind(("127.0.0.1", 0))
        port = closed.getsockname()[1]
    with Client(f"http://127.0.0.1:{port}") as alone, pytest.raises(UnreachableError, match="silhouette serve"):
        next(alone.list())


def test_server_timing_is_read_leniently():
    assert _passes("a;dur=1.5, b;dur=2,c;desc=x") == (("a", 1.5), ("b", 2.0))
    assert _passes("") == ()
