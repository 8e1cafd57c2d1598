"""No error says where anything lies on the server: every route is provoked, and so are the readers of bad meshes."""

import sys
import time
from pathlib import Path

import httpx
import pytest

from client.shapes import write_ply
from tests import meshes, plain_http
from tests.conftest import MAX_UPLOAD_MIB

ROOT = Path(__file__).resolve().parents[2]

BODIES = [
    b"",
    b"{",
    b"[]",
    b"\xff\xfe",
    b"null",
    b'{"width": "wide"}',
    b'{"camera": {"eye": [1e999, 0, 0]}}',
    b"[" * 5000,
    b'{"objects": [{"mesh": "x"}]}',
]
QUERIES = [
    "",
    "?width=wide",
    "?width=99999",
    "?eye=1,2",
    "?unknown=1",
    "?size=1",
    "?limit=0&after=x",
    "?faces=1",
    "?name=../../etc/passwd",
    "?sig=x",
]
HEADERS = [{}, {"Accept": "application/pdf"}, {"Range": "bytes=999999999-"}, {"Content-Type": "multipart/form-data; boundary=x"}]
FILES = {
    "cut.stl": b"\0" * 80 + b"\xff\xff\xff\x7f",
    "lost.obj": b"mtllib /nowhere/lost.mtl\nv 0 0 0\nf 1 2 3\n",
    "odd.ply": b"ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nend_header\n",
    "bad.off": b"OFF\n3 1 0\n0 0 0\n",
    "out.glb": b"glTF\x02\0\0\0\x0c\0\0\0",
    "no.3mf": b"PK\x03\x04nothing",
}


@pytest.fixture(scope="module")
def http(service):
    with plain_http.Client(base_url=service.url, timeout=60.0) as connection:
        yield connection


@pytest.fixture(scope="module")
def needles(service):
    """What no answer may have."""
    places = [str(service.data_dir), str(ROOT), sys.prefix, sys.base_prefix, "site-packages"]
    return [*places, "/usr/", "/tmp/", "/root/", "/home/", "/proc/", "/var/", '.py"', "Traceback", "object at 0x", "Errno"]


def said(answer: httpx.Response) -> str:
    return answer.text + "".join(f"{name}: {value}\n" for name, value in answer.headers.items())


def settled(http, mesh_id):
    deadline = time.monotonic() + 120
    while (mesh := http.get(f"/v1/meshes/{mesh_id}").json())["status"] not in ("ready", "failed"):
        assert time.monotonic() < deadline
        time.sleep(0.1)
    return mesh


def test_no_route_says_where_it_is_whatever_it_is_asked(http, needles, knot, routes):
    seen = {}
    for method, path in routes:
        ids = [("0" * 32, "png"), ("..%2F..%2Fetc%2Fpasswd", "..%2F"), (knot.id, "gif")] if "{" in path else [("", "")]
        for mesh_id, name in ids:
            if method == "DELETE" and mesh_id == knot.id:
                continue
            address = path.format(mesh_id=mesh_id, key_id=mesh_id, suffix=name, name=name)
            asked = [(address + query, HEADERS[n % len(HEADERS)], BODIES[n % len(BODIES)]) for n, query in enumerate(QUERIES)]
            if method == "POST":
                asked += [(address, HEADERS[n % len(HEADERS)], body) for n, body in enumerate(BODIES)]
            for url, headers, body in asked:
                if path.endswith("/events") and mesh_id == knot.id:
                    continue
                answer = http.request(method, url, headers=headers, content=body if method == "POST" else None)
                if answer.status_code >= 400:
                    seen[answer.status_code] = seen.get(answer.status_code, 0) + 1
                    assert [needle for needle in needles if needle in said(answer)] == [], (method, url, answer.text)
                    assert answer.headers["content-type"] == "application/problem+json", (method, url)
    assert {400, 403, 404, 406, 415, 422} <= seen.keys(), seen
    assert sum(seen.values()) > 300 and 500 not in seen, seen


@pytest.mark.parametrize(
    ("method", "address", "headers", "body", "status"),
    [
        ("PUT", "/v1/meshes", {}, None, 405),
        ("GET", "/no/such/page", {}, None, 404),
        ("GET", "/page/..%2F..%2Fsettings.py", {}, None, 404),
        ("POST", "/v1/meshes?name=a.ply", {}, bytes((MAX_UPLOAD_MIB << 20) + 1), 413),
        ("POST", "/v1/scenes/render", {}, bytes(2 << 20), 413),
        ("GET", "/v1/meshes/KNOT/artifacts/hull.glb", {"Range": "bytes=99999999-"}, None, 416),
    ],
)
def test_nor_do_the_refusals_that_need_something_special(http, needles, knot, method, address, headers, body, status):
    answer = http.request(method, address.replace("KNOT", knot.id), headers=headers, content=body)
    assert answer.status_code == status
    assert [needle for needle in needles if needle in said(answer)] == []


@pytest.mark.parametrize("name", FILES)
def test_nor_does_a_mesh_that_cannot_be_read(http, needles, name):
    mesh = http.post(f"/v1/meshes?name={name}", content=FILES[name])
    assert mesh.status_code == 202
    failed = settled(http, mesh.json()["id"])
    assert failed["status"] == "failed"
    base = f"/v1/meshes/{failed['id']}"
    once = http.post(f"/v1/render?name={name}", content=FILES[name])
    answers = [http.get(base), http.get(f"{base}/events"), http.get(f"{base}/render.png"), http.get(f"{base}/accuracy"), once]
    assert once.status_code in (415, 422)
    for answer in answers:
        assert [needle for needle in needles if needle in said(answer)] == [], answer.text
    http.delete(base)


def test_nor_does_a_store_that_is_damaged(http, service, client, needles, tmp_path):
    write_ply(str(tmp_path / "cube.ply"), *meshes.cube(5))
    mesh = client.wait(client.upload(tmp_path / "cube.ply", hull_faces=60, texels=64).id, timeout_s=120.0)
    folder, base = service.data_dir / "store" / "meshes" / mesh.id, f"/v1/meshes/{mesh.id}"
    (folder / "hull.glb").unlink()
    for victims in ([path.name for path in folder.glob("*.safetensors")], ["manifest.json"]):  # before anything of it is mapped
        for name in victims:
            (tmp_path / name).write_bytes(b"damaged")
            (tmp_path / name).replace(folder / name)
        answers = [http.get(f"{base}{rest}") for rest in ("/artifacts/hull.glb", "/render.png", "/silhouette.svg", "")]
        assert any(answer.status_code in {409, 500} for answer in answers)
        for answer in answers:
            assert [needle for needle in needles if needle in said(answer)] == [], answer.text
    http.delete(base)
