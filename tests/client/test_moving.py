"""Moving meshes and sequences by the client and by the command."""

import io
import zipfile

import numpy as np
import pytest
from PIL import Image

from client.errors import RequestError
from client.positions import original_of
from tests import meshes
from tests.client.command import silhouette, silhouette_process
from tests.service.render.moved import bent

VIEW = {"camera": {"eye": [9.0, 6.0, 12.0]}, "width": 96, "height": 80}


@pytest.fixture(scope="module")
def original(client, knot):
    return client.original(knot.id)


def test_the_original_is_the_mesh_that_was_uploaded(original, knot):
    vertices, faces = meshes.knot()
    assert np.allclose(original.positions[original.faces], vertices[faces], atol=1e-6)
    assert len(original.positions) == knot.stats.vertices
    with pytest.raises(ValueError, match="no binary glTF"):
        original_of(bytes(100))


def test_positions_in_the_order_of_the_file(client, knot, original, service, tmp_path):
    vertices, _ = meshes.knot()
    assert np.allclose(original.ordered(vertices), original.positions, atol=1e-6)
    moved = bent(vertices)
    assert np.allclose(original.ordered(np.stack([vertices, moved]))[1], bent(original.positions), atol=1e-5)
    with pytest.raises(ValueError, match="at least 2,560 vertices"):
        original.ordered(vertices[:-1])
    np.save(tmp_path / "file.npy", np.stack([moved.astype(np.float32)] * 2))
    options = ("--positions", tmp_path / "file.npy", "--file-order", "--size", 48)
    run = silhouette("frames", knot.id, "-o", tmp_path / "f.zip", *options, url=service.url)
    assert run.returncode == 0, run.stderr
    alone = client.render(knot.id, positions=bent(original.positions), width=48, height=48)
    with zipfile.ZipFile(tmp_path / "f.zip") as frames:
        drawn, expected = (np.asarray(Image.open(io.BytesIO(body))).astype(int) for body in (frames.read("0001.png"), alone))
    assert np.abs(drawn - expected).max() <= 24


def test_pictures_and_silhouettes_of_arrays_and_of_files(client, knot, original, tmp_path):
    places = bent(original.positions)
    np.save(tmp_path / "bent.npy", places)
    (tmp_path / "bent.f32").write_bytes(places.astype("<f4").tobytes())
    sent = [places, places.tolist(), tmp_path / "bent.npy"]
    pictures = [client.picture(knot.id, positions=one, **VIEW) for one in sent]
    assert len({picture.body for picture in pictures}) == 1
    assert pictures[0].body != client.render(knot.id, **VIEW) and "deform" in pictures[0].plan
    assert client.render(knot.id, positions=tmp_path / "bent.f32", **VIEW) == client.render(
        knot.id, positions=places.astype(np.float32), **VIEW
    )
    found = client.silhouette(knot.id, positions=places, camera=VIEW["camera"])
    assert found["edge_count"] > 10 and found["edges"] != client.silhouette(knot.id, camera=VIEW["camera"])["edges"]
    with pytest.raises(RequestError) as wrong:
        client.render(knot.id, positions=places[:-1])
    assert wrong.value.fields[0]["field"] == "positions"


def test_frames_of_moving_vertices(client, knot, original):
    poses = np.stack([bent(original.positions, 0.2 * step) for step in range(3)])
    film = client.frames(knot.id, positions=poses, turn={}, **VIEW | {"camera": {"orbit": {"azimuth_deg": 0}}})
    assert film.media_type == "image/webp" and dict(film.passes)["pose"] > 0.0
    assert film.frame_ms < sum(ms for _, ms in film.passes)


def test_turntable_command(service, knot, tmp_path):
    run = silhouette_process("turntable", knot.id[:10], "-o", tmp_path / "t.webp", "--frames", 5, "--size", "40x30", url=service.url)
    assert run.returncode == 0, run.stderr
    assert b"\x1b" not in run.stderr + run.stdout, "no terminal codes in a pipe"
    with Image.open(tmp_path / "t.webp") as film:
        assert (film.n_frames, film.size) == (5, (40, 30))
    lined = ("--lines", "edge_mesh", "--ridges", "--fill", "white", "--degrees", -90, "--frames", 2, "--size", 40)
    run = silhouette("turntable", knot.id, "-o", tmp_path / "t.zip", *lined, url=service.url)
    assert run.returncode == 0, run.stderr
    assert zipfile.ZipFile(tmp_path / "t.zip").namelist() == ["0000.png", "0001.png"]


def test_vertices_go_out_and_come_back_by_command(service, knot, tmp_path):
    run = silhouette("original", knot.id, "-o", tmp_path / "rest.npy", url=service.url)
    assert run.returncode == 0, run.stderr
    rest = np.load(tmp_path / "rest.npy")
    assert rest.shape == (knot.stats.vertices, 3)
    np.save(tmp_path / "moved.npy", np.stack([bent(rest, 0.3 * step) for step in range(4)]))
    options = ("--positions", tmp_path / "moved.npy", "--size", 48)
    run = silhouette("frames", knot.id, "-o", tmp_path / "moved.png", *options, "--turn", 90, url=service.url)
    assert run.returncode == 0, run.stderr
    with Image.open(tmp_path / "moved.png") as film:
        assert (film.n_frames, film.size) == (4, (48, 48))
    np.save(tmp_path / "one.npy", bent(rest))
    for command, name in (("render", "m.png"), ("silhouette", "m.svg")):
        run = silhouette(command, knot.id, "-o", tmp_path / name, "--positions", tmp_path / "one.npy", "--size", 48, url=service.url)
        assert run.returncode == 0, run.stderr
    run = silhouette("original", knot.id, "-o", tmp_path / "rest.glb", url=service.url)
    assert (tmp_path / "rest.glb").read_bytes()[:4] == b"glTF"


@pytest.mark.parametrize(
    ("arguments", "word"),
    [
        (("frames", "KNOT", "-o", "x.webp"), "nothing says what changes"),
        (("frames", "KNOT", "-o", "x.webp", "--positions", "short.npy"), "2,560 vertices"),
        (("turntable", "KNOT", "-o", "x.gif"), ".webp"),
        (("render", "short.npy", "-o", "x.png", "--once", "--positions", "short.npy"), "--once"),
        (("original", "KNOT", "-o", "x.obj"), ".npy"),
    ],
)
def test_faults_are_one_line(service, knot, tmp_path, arguments, word):
    np.save(tmp_path / "short.npy", np.zeros((7, 3)))
    run = silhouette(*(knot.id if part == "KNOT" else part for part in arguments), url=service.url, cwd=tmp_path)
    lines = run.stderr.decode().strip().splitlines()
    assert (run.returncode, len(lines)) == (1, 1), lines
    assert lines[0].startswith("error ") and word in lines[0]
