"""Uploading, watching, listing and deleting over real HTTP; what is wrong is named, and nothing is left of it."""

import io
import json
import struct
import zipfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest

from client.errors import MeshFailedError
from client.shapes import write_ply
from schemas.jobs import STAGES
from tests import meshes, plain_http
from tests.conftest import HULL_FACES, MAX_UPLOAD_MIB, TEXELS

OPTIONS = {"hull_faces": HULL_FACES, "texels": TEXELS}


@pytest.fixture(scope="module")
def http(service):
    with plain_http.Client(base_url=service.url, timeout=60.0) as connection:
        yield connection


def ply(tmp_path: Path, mesh) -> bytes:
    path = tmp_path / "mesh.ply"
    write_ply(str(path), *mesh)
    return path.read_bytes()


def stored(service) -> set[str]:
    """Uploads, meshes and uses in the store, and temporary files when there are any that do not go away soon."""
    root = service.data_dir / "store"
    found = {path.relative_to(root) for path in root.rglob("*") if path.is_file()}
    objects = {str(path) for path in found if not path.parts[0].startswith(".") and path.parts[0] not in ("unfinished", "indexed")}
    temporary = root / ".tmp"
    return objects | (set() if _settles(lambda: not any(temporary.iterdir())) else {".tmp"})


def stl_with(corner: float) -> bytes:
    """Binary STL of a tetrahedron, one coordinate of which is `corner`."""
    v = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, corner]], "<f4")
    triangles = [v[[0, 2, 1]], v[[0, 1, 3]], v[[1, 2, 3]], v[[0, 3, 2]]]
    body = b"".join(np.zeros(3, "<f4").tobytes() + t.tobytes() + b"\0\0" for t in triangles)
    return bytes(80) + struct.pack("<I", 4) + body


def bomb() -> bytes:
    """A small 3MF whose model is a gibibyte of spaces, in pieces that zip well."""
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("[Content_Types].xml", '<?xml version="1.0"?><Types/>')
        with archive.open("3D/3dmodel.model", "w", force_zip64=True) as model:
            for _ in range(256):
                model.write(bytes(1 << 20))
    return packed.getvalue()


NO_FACES = b"""ply
format ascii 1.0
element vertex 3
property float x
property float y
property float z
element face 0
property list uchar int vertex_indices
end_header
0 0 0
1 0 0
0 1 0
"""

UNUSABLE = {
    "not a mesh": ("page.stl", b"<!doctype html><html><body>404 not found, but with a friendly face</body></html>" * 3),
    "truncated": ("cut.stl", stl_with(1.0)[:-60]),
    "no faces": ("points.ply", NO_FACES),
    "nan": ("nan.stl", stl_with(float("nan"))),
    "zip bomb": ("bomb.3mf", bomb()),
}


@pytest.mark.parametrize("fault", UNUSABLE)
def test_unusable_mesh_fails_with_a_sentence_and_the_worker_lives_on(http, client, service, fault, tmp_path):
    name, body = UNUSABLE[fault]
    answer = http.post("/v1/meshes", params={"name": name}, content=body)
    assert answer.status_code == 202
    with pytest.raises(MeshFailedError) as failed:
        client.wait(answer.json()["id"], timeout_s=120.0)
    problem = failed.value.problem
    assert problem.status in (415, 422)
    assert len(problem.detail) > 10
    stages = client.info(answer.json()["id"]).stages
    assert [stage.status for stage in stages] == ["failed", *["skipped"] * (len(STAGES) - 1)]
    assert not any(word in problem.detail for word in ("Traceback", "Error(", "/work", str(service.data_dir), "object has no attribute"))

    picture = http.get(f"/v1/meshes/{answer.json()['id']}/render.png")
    assert picture.status_code == 422
    assert picture.headers["content-type"] == "application/problem+json"
    assert picture.json()["detail"] == problem.detail
    assert http.delete(f"/v1/meshes/{answer.json()['id']}").status_code == 204


def test_after_bad_meshes_a_good_one_is_processed(client, tmp_path):
    path = tmp_path / "cube.ply"
    write_ply(str(path), *meshes.cube())
    mesh = client.wait(client.upload(path, **OPTIONS).id, timeout_s=120.0)
    assert mesh.status == "ready"
    client.delete(mesh.id)


@pytest.mark.parametrize(
    ("query", "body", "status", "word"),
    [
        ({"name": "empty.stl"}, b"", 422, "empty"),
        ({"name": "scene.blend"}, b"BLENDER", 415, ".blend"),
        ({"name": "noending"}, b"solid", 415, "format"),
        ({}, b"solid", 415, "format"),
        ({"name": "big.ply"}, bytes((MAX_UPLOAD_MIB << 20) + 1), 413, "MiB"),
        ({"name": "a.ply", "hull_faces": "3"}, b"ply", 422, "hull_faces"),
        ({"name": "a.ply", "texels": "many"}, b"ply", 422, "texels"),
        ({"name": "a.ply", "repair": "perhaps"}, b"ply", 422, "repair"),
        ({"name": "a.ply", "hul_faces": "300"}, b"ply", 422, "hul_faces"),
    ],
)
def test_refused_upload_names_the_fault_and_leaves_nothing(http, service, query, body, status, word):
    before = stored(service)
    answer = http.post("/v1/meshes", params=query, content=body)
    assert (answer.status_code, answer.headers["content-type"]) == (status, "application/problem+json")
    problem = answer.json()
    assert problem["status"] == status
    assert word in problem["detail"]
    assert stored(service) == before


def test_upload_that_does_not_say_its_size_is_stopped_at_the_limit(http, service):
    before = stored(service)
    pieces = (bytes(1 << 18) for _ in range(4 * MAX_UPLOAD_MIB + 4))
    answer = http.post("/v1/meshes", params={"name": "big.ply"}, content=pieces)
    assert answer.status_code == 413
    assert stored(service) == before


def test_upload_that_breaks_off_leaves_nothing(service):
    import socket
    from urllib.parse import urlsplit

    before = stored(service)
    address = urlsplit(service.url)
    with socket.create_connection((address.hostname, address.port)) as raw:
        raw.sendall(b"POST /v1/meshes?name=a.ply HTTP/1.1\r\nHost: x\r\nContent-Length: 1000000\r\n\r\n" + bytes(200_000))
    assert _settles(lambda: stored(service) == before)


def test_form_upload_is_the_same_mesh_as_the_raw_body(http, tmp_path):
    body = ply(tmp_path, meshes.sphere(1))
    raw = http.post("/v1/meshes", params={"name": "ball.ply", **OPTIONS}, content=body)
    form = http.post("/v1/meshes", data={key: str(value) for key, value in OPTIONS.items()}, files={"file": ("ball.ply", body)})
    assert (raw.status_code, form.status_code) == (202, 200)
    assert raw.json()["id"] == form.json()["id"]
    assert raw.headers["location"] == form.headers["location"] == f"/v1/meshes/{raw.json()['id']}"
    http.delete(raw.headers["location"])


def test_form_fields_after_the_file_count(http, tmp_path):
    body = ply(tmp_path, meshes.sphere(1))
    parts = {"file": ("a.ply", body), "hull_faces": (None, "3"), "name": (None, "other.ply")}
    answer = http.post("/v1/meshes", files=parts)
    assert answer.status_code == 422
    assert answer.json()["errors"][0]["field"] == "hull_faces"


@pytest.mark.parametrize(
    ("content_type", "body", "status"),
    [
        ("multipart/form-data; boundary=x", b"--x\r\nbroken", 422),
        ("multipart/form-data; boundary=x", b'--x\r\nContent-Disposition: form-data; name="texels"\r\n\r\n64\r\n--x--\r\n', 422),
        ("multipart/form-data; boundary=x", b"not a form at all", 400),
        ("multipart/form-data", b"--x--", 400),
    ],
)
def test_broken_form_is_a_problem(http, content_type, body, status):
    answer = http.post("/v1/meshes", content=body, headers={"Content-Type": content_type})
    assert answer.status_code == status
    assert answer.headers["content-type"] == "application/problem+json"


def test_content_type_names_the_format_where_the_name_does_not(http, tmp_path):
    body = ply(tmp_path, meshes.cube())
    answer = http.post("/v1/meshes", params=OPTIONS, content=body, headers={"Content-Type": "model/ply"})
    assert (answer.status_code, answer.json()["name"]) == (202, "mesh.ply")
    http.delete(answer.headers["location"])


def test_name_is_shown_without_its_folders(http, tmp_path):
    body = ply(tmp_path, meshes.sphere(1, 2.0))
    answer = http.post("/v1/meshes", params={"name": "..\\../etc/a\x07b.ply", **OPTIONS}, content=body)
    assert answer.json()["name"] == "ab.ply"
    http.delete(answer.headers["location"])


def test_same_upload_twice_is_one_mesh(http, client, knot, knot_file):
    again = http.post("/v1/meshes", params={"name": "other name.ply", **OPTIONS}, content=knot_file.read_bytes())
    assert (again.status_code, again.json()["id"], again.json()["name"]) == (200, knot.id, "small knot.ply")


def test_same_upload_at_the_same_time_is_accepted_once(http, service, tmp_path):
    body = ply(tmp_path, meshes.sphere(1, 8.0))

    def post(_):
        return plain_http.post(f"{service.url}/v1/meshes", params={"name": "s.ply", **OPTIONS}, content=body, timeout=60.0)

    with ThreadPoolExecutor(6) as pool:
        answers = list(pool.map(post, range(6)))
    assert sorted(answer.status_code for answer in answers) == [200] * 5 + [202]
    assert len({answer.json()["id"] for answer in answers}) == 1
    http.delete(answers[0].headers["location"])


def test_other_options_are_another_mesh(http, knot, knot_file):
    other = http.post("/v1/meshes", params={"name": "k.ply", "hull_faces": 300, "texels": TEXELS}, content=knot_file.read_bytes())
    assert other.status_code == 202
    assert other.json()["id"] != knot.id
    assert http.delete(other.headers["location"]).status_code == 204
    assert http.get(f"/v1/meshes/{knot.id}/artifacts/hull.glb").status_code == 200


def test_listing_goes_page_by_page_newest_first(http, knot, tmp_path):
    made = []
    for radius in (3.0, 4.0, 5.0):
        made.append(
            http.post("/v1/meshes", params={"name": "s.ply", **OPTIONS}, content=ply(tmp_path, meshes.sphere(1, radius))).json()["id"]
        )
    seen, link = [], "/v1/meshes?limit=2"
    while link:
        page = http.get(link).json()
        assert len(page["meshes"]) <= 2
        seen += [mesh["id"] for mesh in page["meshes"]]
        link = page.get("next")
    assert seen[:3] == made[::-1]
    assert knot.id in seen
    assert len(seen) == len(set(seen))
    for mesh_id in made:
        http.delete(f"/v1/meshes/{mesh_id}")


@pytest.mark.parametrize(
    ("query", "field"),
    [({"limit": 0}, "limit"), ({"limit": 1000}, "limit"), ({"after": "x"}, "after"), ({"after": "9" * 40 + "-" + "0" * 32}, "after")],
)
def test_wrong_page_is_422(http, query, field):
    answer = http.get("/v1/meshes", params=query)
    assert answer.status_code == 422
    assert answer.json()["errors"][0]["field"] == field


def test_events_end_with_the_mesh_ready(http, tmp_path):
    accepted = http.post("/v1/meshes", params={"name": "s.ply", **OPTIONS}, content=ply(tmp_path, meshes.sphere(2, 6.0))).json()
    with http.stream("GET", accepted["links"]["events"]) as stream:
        assert stream.headers["content-type"].startswith("text/event-stream")
        events = [json.loads(line.removeprefix("data: ")) for line in stream.iter_lines() if line.startswith("data: ")]
    assert events[-1]["status"] == "ready"
    assert {stage["name"] for stage in events[-1]["stages"]} == set(STAGES)
    http.delete(f"/v1/meshes/{accepted['id']}")


def test_deleted_mesh_is_gone_with_all_its_files(http, client, service, tmp_path):
    before = stored(service)
    path = tmp_path / "gone.ply"
    write_ply(str(path), *meshes.sphere(2, 7.0))
    mesh = client.wait(client.upload(path, **OPTIONS).id, timeout_s=120.0)
    assert stored(service) > before
    assert http.delete(f"/v1/meshes/{mesh.id}").status_code == 204
    assert stored(service) == before
    for call in ("", "/render.png", "/thumbnail.png", "/silhouette.svg", "/artifacts/hull.glb", "/events"):
        assert http.get(f"/v1/meshes/{mesh.id}{call}").status_code == 404
    assert http.delete(f"/v1/meshes/{mesh.id}").status_code == 404


def test_mesh_deleted_in_work_stays_gone(http, service, knot_file):
    before = stored(service)
    accepted = http.post("/v1/meshes", params={"name": "k.ply", "hull_faces": 400, "texels": 128}, content=knot_file.read_bytes())
    assert http.get(f"{accepted.headers['location']}/silhouette.svg").status_code == 409
    assert http.delete(accepted.headers["location"]).status_code == 204
    assert _settles(lambda: stored(service) == before, seconds=60.0)


@pytest.mark.parametrize("mesh_id", ["0" * 32, "x", "..", "%2e%2e%2fx", "é"])
def test_unknown_mesh_is_404_everywhere(http, mesh_id):
    for method, call in (
        ("GET", ""),
        ("DELETE", ""),
        ("GET", "/render.png"),
        ("POST", "/render"),
        ("GET", "/thumbnail.webp"),
        ("POST", "/silhouette"),
    ):
        body = {"json": {}} if method == "POST" else {}
        answer = http.request(method, f"/v1/meshes/{mesh_id}{call}", **body)
        # a client makes /v1/render of /v1/meshes/../render, which is there and misses its mesh
        assert answer.status_code in ((404, 405, 415) if answer.request.url.path == f"/v1{call}" else (404, 405)), call
        assert answer.headers["content-type"] == "application/problem+json"


def _settles(condition, seconds=10.0):
    import time

    deadline = time.monotonic() + seconds
    while not condition() and time.monotonic() < deadline:
        time.sleep(0.1)
    return condition()
